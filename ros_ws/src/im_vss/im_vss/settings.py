"""Typed contents of ``vss.yaml``."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from im_cell.robot import Cell
from im_cell.robot.tree import WORLD
from im_cell.sensor import SensorNoise
from im_core.config import Model, fault_in, load_model, package_file
from im_core.errors import ConfigError, NotFoundError
from im_vss.edges import CircleGates, LineGates
from im_vss.laser.calibration import CalibrationGates
from im_vss.laser.line import LaserLineGates
from im_vss.spot import SpotGates

Seconds = Annotated[float, Field(gt=0.0)]


class ExposureRange(Model):
    """Exposure times: the usual one and the limits [s]."""

    nominal: Seconds
    shortest: Seconds
    longest: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if not self.shortest <= self.nominal <= self.longest:
            raise ValueError(f"nominal {self.nominal} is not between {self.shortest} and {self.longest} [s]")
        return self


class Light(Model):
    """The wrist light of calibrations."""

    name: str


class RegionRadius(Model):
    """Largest distance of a light from the predicted place [px]: in a camera as drawn, and in a calibrated one.

    Attributes:
        nominal, calibrated: The radii [px].
        freshness: How far a pose of the robot may be from an exposure to be that at the exposure [s] of testbed time.
    """

    nominal: Annotated[float, Field(gt=0.0)]
    calibrated: Annotated[float, Field(gt=0.0)]
    freshness: Seconds


class StereoSettings(Model):
    """Stereo.

    Attributes:
        pairs: Left and right camera of each pair whose camera infos are rectified together; None: not said.
        epipolar: Farthest that two spots of one light may be from each other's epipolar lines [px].
    """

    pairs: tuple[tuple[str, str], ...] | None = None
    epipolar: Annotated[float, Field(gt=0.0)]


class FiducialSettings(Model):
    """Fiducials: the number of images for the mean corners of a plate."""

    images: Annotated[int, Field(ge=1, le=20)]


class ControlRange(Model):
    """Smallest and largest value of a control of the cameras."""

    low: float
    high: float

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.low > self.high:
            raise ValueError(f"low {self.low} is more than high {self.high}")
        return self


class ControlRanges(Model):
    """Ranges of the controls: gain and read noise relative to the data sheet [-], rate [Hz]; rate 0: on demand."""

    gain: ControlRange
    noise: ControlRange
    rate: ControlRange


class Waits(Model):
    """Longest waits, wall time [s]: for a lease, of a lease, of one that computes, for an exposure."""

    lease: Seconds
    hold: Seconds
    solve: Seconds
    exposure: Seconds


class LaserGrid(Model):
    """Default spots for the calibration of the scanner: a number of angles of each mirror, over the range."""

    mirror1: Annotated[int, Field(ge=2, le=40)]
    mirror2: Annotated[int, Field(ge=2, le=40)]
    range: Annotated[float, Field(gt=0.0)]


class LaserSettings(Model):
    """The laser scanner.

    Attributes:
        services: Services that need a scanner; left out where the cell has none.
        spot_power: Power of the beam where it is a spot, 0 to 1.
        line_power: Where it sweeps the whole range of mirror 1; shorter lines are as bright, and need less.
        settle: Longest wait for the mirrors, wall time [s].
        line: What a line looks like.
        most_lines: Most lines of a scan.
        grid: Spots of a calibration.
        most_spots: Most spots of a calibration.
        calibration: When a calibration is good enough.
    """

    services: tuple[str, ...] = ()
    spot_power: Annotated[float, Field(gt=0.0, le=1.0)]
    line_power: Annotated[float, Field(gt=0.0, le=1.0)]
    settle: Seconds
    line: LaserLineGates
    most_lines: Annotated[int, Field(ge=1)]
    grid: LaserGrid
    most_spots: Annotated[int, Field(ge=1)]
    calibration: CalibrationGates


class FrameSourceEntry(Model):
    """Source of images: an :class:`im_cell.frames.FrameSource` as ``module:Class``, with separate settings."""

    implementation: str
    settings: dict[str, Any]


class VssSettings(Model):
    """Configuration of the Vision Services System; cameras' noise is the data sheet's."""

    services: tuple[str, ...]
    cameras: tuple[str, ...]
    sensor: SensorNoise
    exposure: ExposureRange
    controls: ControlRanges
    light: Light
    spot: SpotGates
    region: RegionRadius
    stereo: StereoSettings
    lines: LineGates
    circles: CircleGates
    fiducials: FiducialSettings
    laser: LaserSettings
    waits: Waits
    frame_source: FrameSourceEntry

    def of_cell(self, cell: Cell) -> Self:
        """Return the settings fitted to a cell: cameras, light, stereo pair, and no Services of a missing laser."""
        cameras, light, pairs = self.cameras or tuple(cell.cameras), self.light.name, self.stereo.pairs
        if pairs is None:
            standing = [name for name in cameras if name in cell.cameras and cell.cameras[name].parent == WORLD]
            pairs = ((standing[0], standing[1]),) if len(standing) > 1 else ()
        return self.model_copy(
            update={
                "services": tuple(name for name in self.services if cell.laser or name not in self.laser.services),
                "cameras": cameras,
                "light": Light(name=light or next(iter(cell.light_names), "")),
                "stereo": StereoSettings(pairs=pairs, epipolar=self.stereo.epipolar),
            }
        )

    def exposure_time(self, wanted: float) -> float:
        """Return a checked exposure time [s].

        Raises:
            ConfigError: It is out of range.
        """
        low, high = self.exposure.shortest, self.exposure.longest
        if not low <= wanted <= high:
            raise ConfigError(f"an exposure of {wanted:g} s is not between {low:g} and {high:g} s", exposure=wanted)
        return wanted

    def check_cameras(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of cameras in a request, if all known and different.

        Raises:
            NotFoundError: One is not known.
            ConfigError: None is given, or one twice.
        """
        if not names:
            raise ConfigError(f"no camera is given (known: {', '.join(self.cameras)})")
        for name in names:
            if name not in self.cameras:
                raise NotFoundError(kind="camera", name=name, known=self.cameras)
        if len(set(names)) != len(names):
            raise ConfigError(f"a camera is given twice: {', '.join(names)}", cameras=list(names))
        return names


def load_settings(cell: Cell, path: Path | None = None) -> VssSettings:
    """Read the settings; the shipped ones by default.

    Raises:
        ConfigError: The file is missing or wrong, or names a camera or light that there is not; the message names file
            and line.
    """
    path = path or package_file("im_vss", "config/vss.yaml")
    settings = load_model(path, VssSettings).of_cell(cell)
    lights, ours = cell.light_names, settings.cameras
    named = [
        *((("cameras", i), "camera", name, cell.cameras) for i, name in enumerate(ours)),
        *(
            (("stereo", "pairs", i, side), "camera of a stereo pair", name, ours)
            for i, pair in enumerate(settings.stereo.pairs or ())
            for side, name in enumerate(pair)
        ),
        *([(("light", "name"), "light", settings.light.name, lights)] if settings.light.name else []),
    ]
    for place, kind, name, known in named:
        if name not in known:
            raise fault_in(path, place, NotFoundError(kind=kind, name=name, known=known).message)
    return settings
