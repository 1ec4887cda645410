"""Calibration data sets in the format ``vislab-calib-1``, one problem per trial; the contained truth is not read.

``docs/calibration.md`` documents the format. What is wrong in a data set is named by its place, such as
``trials[2].u_px[0][17]``; a field that the format does not have is refused.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    StrictBool,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from im_calibration.problem.fields import Lists, Names, kind_of, number, positive
from im_calibration.problem.problem import NOISE_SOURCES, CalibrationProblem, KnownLengths
from im_calibration.problem.target_problem import TargetTable, table_of
from im_calibration.targets.views import TargetViews
from im_cell.lens import PLUMB_BOB, lens_of
from im_cell.workspace import Workspace, box_around
from im_core.config import Fault, FieldError, Model, faults, field_name
from im_core.errors import DataError, nearest
from im_core.files import MEBIBYTE
from im_core.text.jsontext import load_json

Array = NDArray[np.float64]

SCHEMA = "vislab-calib-1"

_LARGEST_FILE = 200 * MEBIBYTE
_LARGEST_IMAGE = 100_000
_UNSTATED_SPOT_PX = 1.0
_ROUNDING = 1e-12


def _image_size(size: object, info: ValidationInfo) -> Array | None:
    """Width and height of all images, shape (1, 2), or of each camera's, shape (c, 2)."""
    each = isinstance(size, list) and bool(size) and isinstance(size[0], list)
    sizes = Lists("c", 2)(size, info) if each else Lists(2)(size, info)
    if sizes is None:
        return None
    for i, (width, height) in enumerate(np.atleast_2d(sizes)):
        if not all(side == int(side) and 1 <= side <= _LARGEST_IMAGE for side in (width, height)):
            sentence = f"is {width:g} x {height:g}, whole numbers of pixels from 1 are needed"
            raise FieldError((i,) if each else (), sentence)
    return np.atleast_2d(sizes)


def _same_schema(schema: object) -> object:
    if schema != SCHEMA:
        raise ValueError(f"is {schema!r}, {SCHEMA!r} is needed")
    return schema


def _any_trials(trials: object) -> object:
    if not isinstance(trials, list) or not trials:
        raise ValueError("must be a list of at least one trial")
    return trials


def _lens_models(value: object) -> tuple[str, ...]:
    """Return names of lens models, one for all cameras or one each; text behind a name is a comment."""
    texts = [value] if isinstance(value, str) else value
    if not isinstance(texts, list) or not texts or not all(isinstance(text, str) for text in texts):
        raise ValueError("must be the name of a lens model, or a list of one for each camera")
    names = tuple(text.split()[0] if text.split() else text for text in texts)
    for name in names:
        try:
            lens_of(name)
        except DataError as error:
            raise ValueError(f"is {name!r}: {error.message}") from error
    return names


class _Section(Model):
    """Base of the objects of a data set."""

    @model_validator(mode="before")
    @classmethod
    def _is_object(cls, content: object) -> object:
        if not isinstance(content, Mapping):
            first = next(field.alias or name for name, field in cls.model_fields.items())
            raise ValueError(f"is {kind_of(content)}, an object with the field {first!r} is needed")
        return content


class LengthTable(_Section):
    """Known lengths [m], uncertainty of the lengths [m], and noise of the spots [px], [px^2]."""

    length_m: Annotated[Array, PlainValidator(Lists("k"))]
    sd_m: Annotated[Array, PlainValidator(Lists("k"))]
    sigma_u_px: Annotated[Array | None, PlainValidator(Lists("c", "k", optional=True)), AfterValidator(positive)] = None
    cov_u_px2: Annotated[Array | None, PlainValidator(Lists("c", "k", 2, 2, 2, optional=True))] = None

    @model_validator(mode="after")
    def _one_noise(self) -> Self:
        if (self.sigma_u_px is None) == (self.cov_u_px2 is None):
            raise FieldError(("sigma_u_px",), "or cov_u_px2 is needed, one of the two")
        return self

    @property
    def spot_covariances(self) -> Array:
        """Covariances of the spots of both LEDs, shape (c, k, 2, 2, 2) [px^2]."""
        if self.cov_u_px2 is not None:
            return self.cov_u_px2
        assert self.sigma_u_px is not None
        return np.asarray(self.sigma_u_px[..., None, None, None] ** 2 * np.tile(np.eye(2), (2, 1, 1)))


class Trial(_Section):
    """LED positions by the robot [m], and the spots of the LED and of the known lengths [px]."""

    x_base_m: Annotated[Array, PlainValidator(Lists("n", 3))]
    u_px: Annotated[Array, PlainValidator(Lists("c", "n", 2, holes=True))]
    length_u_px: Annotated[Array | None, PlainValidator(Lists("c", "k", 2, 2, holes=True, optional=True))] = None
    truth: Any = None


class DataSet(_Section):
    """Data set; earlier fields decide the lengths of later ones; fields of type Any are for people and are not read."""

    schema_name: Annotated[str, PlainValidator(_same_schema), Field(alias="schema")]
    cov_x_m2: Annotated[Array | None, PlainValidator(Lists("n", 3, 3, optional=True))]
    sigma_u_px: Annotated[Array | None, PlainValidator(Lists("c", "n", optional=True)), AfterValidator(positive)] = None
    cov_u_px2: Annotated[Array | None, PlainValidator(Lists("c", "n", 2, 2, optional=True))] = None
    noise_to_estimate: tuple[Literal["image", "robot"], ...] = ()
    image_size: Annotated[Array, PlainValidator(_image_size)]
    distortion_model: Annotated[tuple[str, ...], PlainValidator(_lens_models)] = ()
    led_offset_nominal_known: StrictBool = True
    led_offset_prior_sd_m: Annotated[float | None, PlainValidator(number)] = None
    led_offset_nominal_m: Annotated[Array, PlainValidator(Lists(3))] = Field(default_factory=lambda: np.zeros(3))
    workspace_m: Annotated[Array | None, PlainValidator(Lists(2, 3, optional=True))] = None
    joint_offset_prior_sd_rad: Annotated[float | None, PlainValidator(number)] = None
    J_joint: Annotated[Array | None, PlainValidator(Lists("n", 3, "joints", optional=True))] = None
    J_arm: Annotated[Array | None, PlainValidator(Lists("n", 3, "errors", optional=True))] = None
    wrist_rotations: Annotated[
        Array | None, PlainValidator(Lists("n", 3, 3, optional=True)), Field(alias="wrist_R_base")
    ] = None
    known_lengths: LengthTable | None = None
    trials: Annotated[tuple[Trial, ...], BeforeValidator(_any_trials)]
    camera_names: Annotated[tuple[str, ...] | None, PlainValidator(Names("c"))] = None
    pose_names: Annotated[tuple[str, ...] | None, PlainValidator(Names("n"))] = None
    reading: Annotated[tuple[str, ...] | None, PlainValidator(Names("n", different=False))] = None
    name: Any = None
    description: Any = None
    pixel_convention: Any = None
    n_points: Any = None
    n_cameras: Any = None
    n_trials: Any = None
    truth: Any = None
    heldout_points_base_m: Any = None
    bounds_crlb_rms: Any = None
    reference_rms: Any = None
    expect: Any = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not {"sigma_u_px", "cov_u_px2"} & self.model_fields_set:
            raise ValueError("has no field 'sigma_u_px' or 'cov_u_px2', null where the noise is not known")
        if self.sigma_u_px is not None and self.cov_u_px2 is not None:
            raise FieldError(("cov_u_px2",), "and sigma_u_px are both given, one says all")
        if not self.led_offset_nominal_known:
            unknown = "where the LED offset is not known"
            if self.led_offset_prior_sd_m is None:
                raise FieldError(("led_offset_prior_sd_m",), f"is null, a number is needed {unknown}")
            if self.led_offset_prior_sd_m <= 0.0:
                prior = f"{self.led_offset_prior_sd_m:g}"
                raise FieldError(("led_offset_prior_sd_m",), f"is {prior}, it must be > 0 [m] {unknown}")
            if self.wrist_rotations is None:
                raise FieldError(("wrist_R_base",), f"is null, rotations are needed {unknown}")
        if self.joint_offset_prior_sd_rad and self.J_joint is None:
            raise FieldError(("J_joint",), "is null, derivatives are needed where joint_offset_prior_sd_rad is not 0")
        for i, trial in enumerate(self.trials):
            if self.known_lengths is not None and trial.length_u_px is None:
                raise FieldError(("trials", i), "has no field 'length_u_px'")
        return self

    def problem(self, trial: Trial) -> CalibrationProblem:
        """Return the problem of a trial; unstated noise gets a size to be found by the calibration.

        Raises:
            DataError: A value cannot be.
        """
        c, n = trial.u_px.shape[:2]
        joint_prior = self.joint_offset_prior_sd_rad or 0.0
        sizes = np.broadcast_to(self.image_size, (c, 2)).astype(int)
        spot_covariances = self._spot_covariances(c, n)
        return CalibrationProblem(
            camera_names=self.camera_names or tuple(f"camera_{j}" for j in range(c)),
            image_sizes=tuple((int(width), int(height)) for width, height in sizes),
            positions=trial.x_base_m,
            position_covariances=self._position_covariances(trial, spot_covariances),
            wrist_rotations=np.tile(np.eye(3), (n, 1, 1)) if self.wrist_rotations is None else self.wrist_rotations,
            spots=trial.u_px,
            spot_covariances=spot_covariances,
            led_offset_prior_sd=0.0 if self.led_offset_nominal_known else self.led_offset_prior_sd_m or 0.0,
            led_offset_nominal=_place(self.led_offset_nominal_m),
            joint_offset_prior_sd=joint_prior,
            joint_jacobians=self.J_joint if joint_prior else None,
            arm_jacobians=self.J_arm,
            workspace=box_around(trial.x_base_m)
            if self.workspace_m is None
            else Workspace(*map(_place, self.workspace_m)),
            pose_names=self.pose_names or (),
            readings=self.reading or (),
            lengths=self._lengths(trial),
            noise_to_estimate=self._noise_to_estimate,
            lens_models=self.distortion_model * c if len(self.distortion_model) == 1 else self.distortion_model,
        )

    @property
    def _noise_to_estimate(self) -> tuple[str, ...]:
        unstated = set(self.noise_to_estimate)
        if self.sigma_u_px is None and self.cov_u_px2 is None:
            unstated.add("image")
        if self.cov_x_m2 is None:
            unstated.add("robot")
        return tuple(source for source in NOISE_SOURCES if source in unstated)

    def _spot_covariances(self, c: int, n: int) -> Array:
        if self.cov_u_px2 is not None:
            return self.cov_u_px2
        sigma = np.full((c, n), _UNSTATED_SPOT_PX) if self.sigma_u_px is None else self.sigma_u_px
        return np.asarray(sigma[..., None, None] ** 2 * np.eye(2))

    def _position_covariances(self, trial: Trial, spot_covariances: Array) -> Array:
        """As stated; else as large as the noise of the spots is when seen from a camera."""
        if self.cov_x_m2 is not None:
            return self.cov_x_m2
        seen = ~np.isnan(trial.u_px[..., 0])
        if not seen.any():
            return np.tile(np.eye(3), (trial.u_px.shape[1], 1, 1))
        spot = np.sqrt(np.median(np.trace(spot_covariances[seen], axis1=1, axis2=2)) / 2.0)
        pixels, metres = np.nanstd(trial.u_px[seen], axis=0).max(), np.std(trial.x_base_m, axis=0).max()
        variance = (spot * metres / pixels) ** 2 if pixels > 0.0 and metres > 0.0 else 1.0
        return np.tile(variance * np.eye(3), (trial.u_px.shape[1], 1, 1))

    def _lengths(self, trial: Trial) -> KnownLengths | None:
        known, spots = self.known_lengths, trial.length_u_px
        if known is None or spots is None:
            return None
        return KnownLengths(known.length_m, known.sd_m, spots, known.spot_covariances)


class TargetDataSet(_Section):
    """Data set of views of a target, in place of positions of a light."""

    schema_name: Annotated[str, PlainValidator(_same_schema), Field(alias="schema")]
    target: TargetTable
    image_size: Annotated[Array, PlainValidator(_image_size)]
    distortion_model: Annotated[tuple[str, ...], PlainValidator(_lens_models)] = (PLUMB_BOB.name,)
    camera_names: Annotated[tuple[str, ...] | None, PlainValidator(Names("c"))] = None
    noise_to_estimate: tuple[Literal["image", "robot"], ...] = ()
    name: Any = None
    description: Any = None
    truth: Any = None

    @property
    def problem(self) -> CalibrationProblem:
        """The problem.

        Raises:
            DataError: A value cannot be, or the views do not determine where to start.
        """
        c = len(self.target.u_px)
        sizes = np.broadcast_to(self.image_size, (c, 2)).astype(int)
        names = self.camera_names or tuple(f"camera_{j}" for j in range(c))
        lenses = self.distortion_model * c if len(self.distortion_model) == 1 else self.distortion_model
        size = tuple((int(width), int(height)) for width, height in sizes)
        return self.target.problem(names, size, lenses, self.noise_to_estimate)


def load_problems(path: Path) -> tuple[CalibrationProblem, ...]:
    """The problems of a file.

    Raises:
        DataError: It cannot be read, is no JSON, or not of this format; file, line or field are named.
    """
    content = load_json(path, _LARGEST_FILE)
    try:
        return problems(content)
    except DataError as error:
        raise _placed(str(path), error) from error


def problems(content: object) -> tuple[CalibrationProblem, ...]:
    """The problem of each trial of a data set.

    Raises:
        DataError: A field is missing, or has the wrong shape or an impossible value; field, trial and pose are named.
    """
    model = TargetDataSet if isinstance(content, Mapping) and "target" in content else DataSet
    try:
        data = model.model_validate(content, context={})
    except ValidationError as error:
        first = _first_fault(faults(error, model))
        place = field_name(first.location) or "the data set"
        above = field_name(first.location[:-1]) or "the data set"
        sentence = f"{place} {first.words}"
        if first.kind == "missing":
            sentence = f"{above} has no field {first.location[-1]!r}"
        elif first.kind == "extra_forbidden":
            unknown = str(first.location[-1])
            sentence = f"{above} has the field {unknown!r}, which the format does not{nearest(unknown, first.known)}"
        elif first.kind == "bool_type":
            sentence = f"{place} is {first.value!r}, true or false is needed"
        elif first.kind in ("literal_error", "tuple_type"):
            sentence = f"{place} is {first.value!r}, a list of {' and '.join(map(repr, NOISE_SOURCES))} is needed"
        raise DataError(f"{sentence}.", field=field_name(first.location)) from error
    if isinstance(data, TargetDataSet):
        return (data.problem,)
    found = []
    for i, trial in enumerate(data.trials):
        try:
            found.append(data.problem(trial))
        except DataError as error:
            raise _placed(f"trials[{i}]", error) from error
    return tuple(found)


def dataset_of_views(views: TargetViews, noise_to_estimate: Sequence[str]) -> dict[str, Any]:
    """Return a data set of some views, as a table of JSON."""
    return {
        "schema": SCHEMA,
        "camera_names": list(views.camera_names),
        "image_size": [list(size) for size in views.image_sizes],
        "distortion_model": list(views.lens_models),
        "noise_to_estimate": list(noise_to_estimate),
        "target": table_of(views),
    }


def dataset_of(problem: CalibrationProblem) -> dict[str, Any]:
    """Return a data set of one trial, without truth; the inverse of :func:`problems`.

    >>> list(dataset_of(problem))[:4]
    ['schema', 'camera_names', 'pose_names', 'image_size']
    """
    sizes, models = [list(size) for size in problem.image_sizes], problem.lens_models
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "camera_names": list(problem.camera_names),
        "pose_names": list(problem.pose_names),
        "image_size": sizes[0] if len(set(problem.image_sizes)) == 1 else sizes,
        "cov_x_m2": problem.position_covariances.tolist(),
        **_spot_noise(problem.spot_covariances, problem.detected),
        "distortion_model": models[0] if len(set(models)) == 1 else list(models),
        "noise_to_estimate": list(problem.noise_to_estimate),
        "wrist_R_base": problem.wrist_rotations.tolist(),
        "led_offset_nominal_known": problem.led_offset_prior_sd == 0.0,
        "led_offset_prior_sd_m": problem.led_offset_prior_sd,
        "led_offset_nominal_m": list(problem.led_offset_nominal),
        "workspace_m": [list(problem.workspace.low), list(problem.workspace.high)],
        "trials": [{"x_base_m": problem.positions.tolist(), "u_px": _spots(problem.spots)}],
    }
    if problem.readings:
        content["reading"] = list(problem.readings)
    if problem.joint_jacobians is not None:
        content |= {
            "J_joint": problem.joint_jacobians.tolist(),
            "joint_offset_prior_sd_rad": problem.joint_offset_prior_sd,
        }
    if problem.arm_jacobians is not None:
        content["J_arm"] = problem.arm_jacobians.tolist()
    if (lengths := problem.lengths) is not None:
        one_noise = _spot_noise(lengths.spot_covariances, lengths.detected)
        sigma = np.array(one_noise.get("sigma_u_px", []))
        if sigma.ndim == 3 and np.array_equal(sigma[..., 0], sigma[..., 1]):
            noise: dict[str, Any] = {"sigma_u_px": sigma[..., 0].tolist()}
        else:
            noise = {"cov_u_px2": lengths.spot_covariances.tolist()}
        content["known_lengths"] = {
            "length_m": lengths.lengths.tolist(),
            "sd_m": lengths.standard_deviations.tolist(),
            **noise,
        }
        content["trials"][0]["length_u_px"] = [_spots(row) for row in lengths.spots]
    return content


def _first_fault(found: list[Fault]) -> Fault:
    """Return the fault to report: an extra field before missing ones, since the extra one may be a misspelling."""
    return next((fault for fault in found if fault.kind == "extra_forbidden"), found[0])


def _placed(place: str, error: DataError) -> DataError:
    """Return the same error, the message preceded by the place."""
    placed = DataError(f"{place}: {error.message}", code=error.code)
    placed.facts.update({"place": place, **error.facts})
    return placed


def _place(array: Array) -> tuple[float, float, float]:
    x, y, z = map(float, array)
    return x, y, z


def _spot_noise(covariances: Array, detected: NDArray[np.bool_]) -> dict[str, Any]:
    """Return standard deviations if sufficient, else covariances; 1 px if neither spot nor covariance is given."""
    given = np.isfinite(covariances).all(axis=(-2, -1)) | detected
    covariances = np.where(given[..., None, None], covariances, np.eye(2))
    sigma = np.sqrt(covariances[..., 0, 0])
    round_ones = sigma[..., None, None] ** 2 * np.eye(2)
    if np.all(np.abs(covariances - round_ones) <= _ROUNDING * sigma[..., None, None] ** 2):
        return {"sigma_u_px": sigma.tolist()}
    return {"cov_u_px2": covariances.tolist()}


def _spots(spots: Array) -> list[list[list[float] | None]]:
    """Spots, shape (m, n, 2), as lists; null where not detected."""
    return [[None if np.isnan(spot).any() else spot.tolist() for spot in row] for row in spots]
