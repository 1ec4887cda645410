"""Calibration data sets in the format ``vislab-calib-1``, one problem a trial; the truth in them is not looked at.

What is wrong in one is named by its place, such as ``trials[2].u_px[0][17]``.
"""

import json
from collections.abc import Mapping
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    StrictBool,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from im_calibration.problem.problem import CalibrationProblem, KnownLengths
from im_cell.workspace import Workspace
from im_core.config import FieldError, Model, faults, field_name
from im_core.errors import DataError

Array = NDArray[np.float64]

SCHEMA = "vislab-calib-1"

_LARGEST_IMAGE = 100_000
_LARGEST_NUMBER = 1e12


class Lists:
    """Validator of nested lists of numbers, which makes an array of them.

    Args:
        lengths: From the outside in; a letter stands for a number that the first field with that letter decides.
        holes: Whether the innermost lists may be null; they become NaN.
        optional: Whether the whole may be null.
    """

    def __init__(self, *lengths: int | str, holes: bool = False, optional: bool = False) -> None:
        self._lengths, self._holes, self._optional = lengths, holes, optional

    def __call__(self, value: object, info: ValidationInfo) -> Array | None:
        """The array; list after list is laid out flat, so that large data sets take no longer than they must."""
        if value is None and self._optional:
            return None
        decided: dict[str, int] = info.context if info.context is not None else {}
        elements: list[Any] = [value]
        shape: list[int] = []
        empty = np.zeros(1, dtype=bool)
        for depth, length in enumerate(self._lengths):
            wanted = length if isinstance(length, int) else decided.get(length)
            or_null = self._holes and depth == len(self._lengths) - 1
            if or_null and wanted is not None:
                empty = np.repeat(np.array([element is None for element in elements], dtype=bool), wanted)
                hole = [np.nan] * wanted
                elements = [hole if element is None else element for element in elements]
            for i, element in enumerate(elements):
                if type(element) is not list:
                    a_list = "a list" + f" of {wanted}" * (wanted is not None) + " or null" * or_null
                    raise _misplaced(i, shape, f"is {_kind(element)}, {a_list} is needed")
                if wanted is None:
                    wanted = decided[str(length)] = len(element)
                if len(element) != wanted:
                    raise _misplaced(i, shape, f"has {len(element)} elements, {wanted} are needed")
            shape.append(wanted or 0)
            elements = list(chain.from_iterable(elements))
        for kind in set(map(type, elements)):
            if kind is bool or not issubclass(kind, int | float):
                i = next(i for i, element in enumerate(elements) if type(element) is kind)
                raise _misplaced(i, shape, f"is {_kind(elements[i])}, a number is needed")
        try:
            array = np.array(elements, dtype=float)
        except OverflowError:  # an integer that no floating-point number holds
            array = np.array([element if abs(element) < _LARGEST_NUMBER else np.inf for element in elements])
        for i in map(int, np.flatnonzero(~(np.abs(array) <= _LARGEST_NUMBER) & ~empty)):
            raise _misplaced(i, shape, f"is {array[i]:g}, a finite number of sensible size is needed")
        return array.reshape(shape)


class Names:
    """Validator of an optional list of different names, as many as a letter of :class:`Lists` stands for."""

    def __init__(self, length: str) -> None:
        self._length = length

    def __call__(self, names: object, info: ValidationInfo) -> tuple[str, ...] | None:
        """The names."""
        if names is None:
            return None
        if not isinstance(names, list) or not all(isinstance(name, str) and name for name in names):
            raise ValueError("must be a list of names")
        wanted = (info.context or {}).get(self._length)
        if len(names) != wanted or len(set(names)) != len(names):
            raise ValueError(f"must be {wanted} different names, got {', '.join(names)}")
        return tuple(names)


def _number(value: object, info: ValidationInfo) -> float | None:
    array = Lists(optional=True)(value, info)
    return None if array is None else float(array)


def _image_size(size: Array) -> tuple[int, int]:
    width, height = size
    if not all(side == int(side) and 1 <= side <= _LARGEST_IMAGE for side in size):
        raise ValueError(f"is {width:g} x {height:g}, whole numbers of pixels from 1 are needed")
    return int(width), int(height)


def _positive(sigma: Array) -> Array:
    for place in np.argwhere(sigma <= 0.0):
        raise FieldError(tuple(int(i) for i in place), f"is {sigma[tuple(place)]:g}, it must be > 0 [px]")
    return sigma


def _same_schema(schema: object) -> object:
    if schema != SCHEMA:
        raise ValueError(f"is {schema!r}, {SCHEMA!r} is needed")
    return schema


def _any_trials(trials: object) -> object:
    if not isinstance(trials, list) or not trials:
        raise ValueError("must be a list of at least one trial")
    return trials


class _Section(Model):
    """Base of the objects of a data set, which may hold more than is read."""

    model_config = ConfigDict(extra="ignore")

    @model_validator(mode="before")
    @classmethod
    def _is_object(cls, content: object) -> object:
        if not isinstance(content, Mapping):
            first = next(field.alias or name for name, field in cls.model_fields.items())
            raise ValueError(f"is {_kind(content)}, an object with the field {first!r} is needed")
        return content


class LengthTable(_Section):
    """Known lengths [m], how well they are known [m], and the standard deviations of their spots [px]."""

    length_m: Annotated[Array, PlainValidator(Lists("k"))]
    sd_m: Annotated[Array, PlainValidator(Lists("k"))]
    sigma_u_px: Annotated[Array, PlainValidator(Lists("c", "k"))]


class Trial(_Section):
    """LED positions by the robot [m], and the spots of the LED and of the known lengths [px]."""

    x_base_m: Annotated[Array, PlainValidator(Lists("n", 3))]
    u_px: Annotated[Array, PlainValidator(Lists("c", "n", 2, holes=True))]
    length_u_px: Annotated[Array | None, PlainValidator(Lists("c", "k", 2, 2, holes=True, optional=True))] = None


class DataSet(_Section):
    """A data set; ``calibrate_dataset --help`` says what its fields mean. Those before decide the lengths of others."""

    schema_name: Annotated[str, PlainValidator(_same_schema), Field(alias="schema")]
    cov_x_m2: Annotated[Array, PlainValidator(Lists("n", 3, 3))]
    sigma_u_px: Annotated[Array, PlainValidator(Lists("c", "n")), AfterValidator(_positive)]
    image_size: Annotated[tuple[int, int], PlainValidator(Lists(2)), AfterValidator(_image_size)]
    led_offset_nominal_known: StrictBool = True
    led_offset_prior_sd_m: Annotated[float | None, PlainValidator(_number)] = None
    joint_offset_prior_sd_rad: Annotated[float | None, PlainValidator(_number)] = None
    J_joint: Annotated[Array | None, PlainValidator(Lists("n", 3, "joints", optional=True))] = None
    wrist_rotations: Annotated[
        Array | None, PlainValidator(Lists("n", 3, 3, optional=True)), Field(alias="wrist_R_base")
    ] = None
    camera_names: Annotated[tuple[str, ...] | None, PlainValidator(Names("c"))] = None
    pose_names: Annotated[tuple[str, ...] | None, PlainValidator(Names("n"))] = None
    known_lengths: LengthTable | None = None
    trials: Annotated[tuple[Trial, ...], BeforeValidator(_any_trials)]

    @model_validator(mode="after")
    def _whole(self) -> Self:
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
        """The problem of a trial.

        Raises:
            DataError: A value cannot be.
        """
        n, c = len(self.cov_x_m2), len(self.sigma_u_px)
        joint_prior = self.joint_offset_prior_sd_rad or 0.0
        return CalibrationProblem(
            camera_names=self.camera_names or tuple(f"camera_{j}" for j in range(c)),
            image_sizes=(self.image_size,) * c,
            positions=trial.x_base_m,
            position_covariances=self.cov_x_m2,
            wrist_rotations=np.tile(np.eye(3), (n, 1, 1)) if self.wrist_rotations is None else self.wrist_rotations,
            spots=trial.u_px,
            spot_covariances=self.sigma_u_px[..., None, None] ** 2 * np.eye(2),
            led_offset_prior_sd=0.0 if self.led_offset_nominal_known else self.led_offset_prior_sd_m or 0.0,
            joint_offset_prior_sd=joint_prior,
            joint_jacobians=self.J_joint if joint_prior else None,
            workspace=_box_around(trial.x_base_m),
            pose_names=self.pose_names or (),
            lengths=self._lengths(trial),
        )

    def _lengths(self, trial: Trial) -> KnownLengths | None:
        known, spots = self.known_lengths, trial.length_u_px
        if known is None or spots is None:
            return None
        covariances = known.sigma_u_px[..., None, None, None] ** 2 * np.tile(np.eye(2), (2, 1, 1))
        return KnownLengths(known.length_m, known.sd_m, spots, covariances)


def load_problems(path: Path) -> tuple[CalibrationProblem, ...]:
    """The problems of a file.

    Args:
        path: The file.

    Raises:
        DataError: It cannot be read, is no JSON, or not of this format; file, line or field are named.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise DataError(f"{path}: {error.strerror}.", file=str(path)) from error
    except json.JSONDecodeError as error:
        raise DataError(f"{path}:{error.lineno}: not JSON: {error.msg}.", file=str(path), line=error.lineno) from error
    except (UnicodeDecodeError, RecursionError, ValueError) as error:
        reason = "nested too deeply" if isinstance(error, RecursionError) else str(error)
        raise DataError(f"{path}: not JSON: {reason}.", file=str(path)) from error
    try:
        return problems(content)
    except DataError as error:
        raise _placed(str(path), error) from error


def problems(content: object) -> tuple[CalibrationProblem, ...]:
    """The problem of each trial of a data set.

    Args:
        content: Contents of the file.

    Raises:
        DataError: A field is missing, or has the wrong shape or an impossible value; field, trial and pose are named.
    """
    try:
        data = DataSet.model_validate(content, context={})
    except ValidationError as error:
        first = faults(error, DataSet)[0]  # others may only follow from it
        place = field_name(first.location) or "the data set"
        sentence = f"{place} {first.words}"
        if first.kind == "missing":
            sentence = f"{field_name(first.location[:-1]) or 'the data set'} has no field {first.location[-1]!r}"
        elif first.kind == "bool_type":
            sentence = f"{place} is {first.value!r}, true or false is needed"
        raise DataError(f"{sentence}.", field=field_name(first.location)) from error
    found = []
    for i, trial in enumerate(data.trials):
        try:
            found.append(data.problem(trial))
        except DataError as error:
            raise _placed(f"trials[{i}]", error) from error
    return tuple(found)


def dataset_of(problem: CalibrationProblem) -> dict[str, Any]:
    """A data set of one trial, without truth; the inverse of :func:`problems`.

    The format has one standard deviation a spot: the root of the mean variance of its coordinates.

    Args:
        problem: The observations.

    Raises:
        DataError: The images differ in size; the format has one size for all cameras.
    """
    if len(set(problem.image_sizes)) > 1:
        raise DataError(f"a data set has one image size for all cameras, not {sorted(set(problem.image_sizes))}")
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "camera_names": list(problem.camera_names),
        "pose_names": list(problem.pose_names),
        "image_size": list(problem.image_sizes[0]),
        "cov_x_m2": problem.position_covariances.tolist(),
        "sigma_u_px": _sigma(problem.spot_covariances).tolist(),
        "wrist_R_base": problem.wrist_rotations.tolist(),
        "led_offset_nominal_known": problem.led_offset_prior_sd == 0.0,
        "led_offset_prior_sd_m": problem.led_offset_prior_sd,
        "trials": [{"x_base_m": problem.positions.tolist(), "u_px": _spots(problem.spots)}],
    }
    if problem.joint_jacobians is not None:
        content |= {
            "J_joint": problem.joint_jacobians.tolist(),
            "joint_offset_prior_sd_rad": problem.joint_offset_prior_sd,
        }
    if (lengths := problem.lengths) is not None:
        content["known_lengths"] = {
            "length_m": lengths.lengths.tolist(),
            "sd_m": lengths.standard_deviations.tolist(),
            "sigma_u_px": _sigma(lengths.spot_covariances.mean(axis=2)).tolist(),
        }
        content["trials"][0]["length_u_px"] = [_spots(row) for row in lengths.spots]
    return content


def _misplaced(number: int, shape: list[int], sentence: str) -> FieldError:
    """What is wrong with one of the elements of lists of a shape, counted through."""
    return FieldError(tuple(int(i) for i in np.unravel_index(number, shape)) if shape else (), sentence)


def _kind(value: object) -> str:
    names = {dict: "an object", list: "a list", str: "a text", bool: "a truth value", type(None): "null"}
    return names.get(type(value), "a number")


def _placed(place: str, error: DataError) -> DataError:
    """The same error, its message led by where it is."""
    placed = DataError(f"{place}: {error.message}", code=error.code)
    placed.facts.update({"place": place, **error.facts})
    return placed


def _box_around(positions: Array) -> Workspace:
    """Box of most positions: errors are predicted where data are, which a file says nothing else about."""
    if not len(positions):
        return Workspace()
    low, high = np.quantile(positions, 0.03, axis=0), np.quantile(positions, 0.97, axis=0)
    high = np.maximum(high, low + np.maximum(1e-3, 1e-6 * np.abs(low)))
    return Workspace((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is no number of JSON")


def _sigma(covariances: Array) -> Array:
    """Standard deviation of a coordinate, shape (...), of covariances, shape (..., 2, 2) [px]."""
    return np.asarray(np.sqrt(np.trace(covariances, axis1=-2, axis2=-1) / 2.0))


def _spots(spots: Array) -> list[list[list[float] | None]]:
    """Spots, shape (m, n, 2), as lists; null where not detected."""
    return [[None if np.isnan(spot).any() else spot.tolist() for spot in row] for row in spots]
