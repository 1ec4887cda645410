"""Typed contents of ``vss.yaml``."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from im_core.config import Model, load_model, package_file
from im_core.errors import ConfigError, NotFoundError
from im_core.robot import Cell
from im_vss.spot import SensorNoise, SpotGates

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
    """The wrist light of calibrations: its name, and the prior sd of its offset in the wrist frame [m]."""

    name: str
    offset_prior_sd: Annotated[float, Field(ge=0.0)]


class Waits(Model):
    """Longest waits, wall time [s]: for a lease, of a lease, for an exposure, for the camera process."""

    lease: Seconds
    hold: Seconds
    exposure: Seconds
    camera_start: Seconds


class VssSettings(Model):
    """Configuration of the Vision Services System; cameras' noise is their data sheet's."""

    services: tuple[str, ...]
    cameras: Annotated[tuple[str, ...], Field(min_length=1)]
    sensor: SensorNoise
    exposure: ExposureRange
    light: Light
    spot: SpotGates
    waits: Waits
    renderer: Literal["auto", "egl", "tiny"]

    def exposure_time(self, wanted: float) -> float:
        """Exposure time for a request [s]; 0 stands for the nominal one.

        Raises:
            ConfigError: It is out of range.
        """
        if wanted == 0.0:
            return self.exposure.nominal
        low, high = self.exposure.shortest, self.exposure.longest
        if not low <= wanted <= high:
            raise ConfigError(f"an exposure of {wanted:g} s is not between {low:g} and {high:g} s", exposure=wanted)
        return wanted

    def check_cameras(self, names: tuple[str, ...]) -> tuple[str, ...]:
        """The names of cameras in a request, if they are all known and differ.

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
        ConfigError: The file is missing or wrong; the message names file and line.
        NotFoundError: The cell has no camera or light of a given name.
    """
    settings = load_model(path or package_file("im_vss", "config/vss.yaml"), VssSettings)
    for name in settings.cameras:
        if name not in cell.cameras:
            raise NotFoundError(kind="camera", name=name, known=cell.cameras)
    if settings.light.name not in cell.light_names:
        raise NotFoundError(kind="light", name=settings.light.name, known=cell.light_names)
    return settings
