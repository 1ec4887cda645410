"""The surroundings of the Vision Services System: settings, cameras and the controls, monitors."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import FrameSource, SnapOrder
from im_cell.robot import Cell
from im_cell.sensor import SensorControls
from im_core.errors import StateError
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Mounts
from im_vss.laser.book import LaserBook
from im_vss.laser.scanner import Scanner
from im_vss.monitor import Monitors, Screen
from im_vss.pending_looks import Looks
from im_vss.settings import VssSettings


class CameraControls:
    """Controls of each camera, and the common exposure time; any thread may set and read the controls."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sensors: dict[str, SensorControls] = {}
        self._exposure_s: float | None = None

    def set_sensor(self, camera: str, controls: SensorControls) -> None:
        """Set gain and noise of a camera from the next exposure on."""
        with self._lock:
            self._sensors[camera] = controls

    def set_exposure(self, exposure_s: float) -> None:
        """Set the exposure time for requests with 0 [s]."""
        with self._lock:
            self._exposure_s = exposure_s

    def sensors(self, cameras: tuple[str, ...]) -> dict[str, SensorControls]:
        """The controls of some cameras."""
        with self._lock:
            return {camera: self._sensors.get(camera, SensorControls()) for camera in cameras}

    def exposure(self, wanted: float, nominal: float) -> float:
        """Return the exposure time for a request [s]: the wanted one, else the set one, else the nominal one."""
        with self._lock:
            return wanted or self._exposure_s or nominal


@dataclass(frozen=True)
class LaserRig:
    """The laser scanner: the driver, and the present calibration."""

    scanner: Scanner
    book: LaserBook


@dataclass(frozen=True)
class Rig:
    """Hardware and settings, as handed to Vision Modules, Tools and Services.

    Attributes:
        settings: Configuration of the Vision Services System.
        cell: Nominal parameters of the cell.
        book: Present calibration of each camera.
        source: The cameras; None: another process has them.
        screen: Where images go; None: likewise.
        monitors: Image planes of the display.
        controls: How each camera's sensor is set, and the exposure time that 0 stands for.
        light_position: Where the robot's pose puts the light of calibrations at a testbed time [ns]: place in the
            world, shape (3,) [m]; None if that is not known.
        why_dark: That all wrist lights are off, and what switches them on, a clause; empty if one is on, or that is not
            known.
        mounts: Where the frames of the robot that carry cameras were at exposures.
        laser: The laser scanner; None where there is none.
        looks: Images in which the light is searched while the arms go on.
    """

    settings: VssSettings
    cell: Cell
    book: CameraBook
    source: FrameSource | None
    screen: Screen | None
    monitors: Monitors = field(default_factory=Monitors)
    controls: CameraControls = field(default_factory=CameraControls)
    light_position: Callable[[int], NDArray[np.float64] | None] = lambda stamp_ns: None
    why_dark: Callable[[], str] = lambda: ""
    mounts: Mounts = field(default_factory=Mounts)
    laser: LaserRig | None = None
    looks: Looks[Any] = field(default_factory=Looks)

    def order(
        self,
        cameras: tuple[str, ...],
        exposure_s: float,
        blank_light: tuple[bool, ...],
        blank_laser: tuple[bool, ...] = (),
    ) -> SnapOrder:
        """Return an order for exposures of cameras with the present settings.

        Args:
            cameras: Names of the cameras.
            exposure_s: Length of each exposure [s]; 0: the one that is set.
            blank_light: For each frame, whether the wrist lights are strobed off.
            blank_laser: For each frame, whether the laser is; empty: in none.

        Raises:
            ImError: A camera is unknown, or the exposure out of range.
        """
        settings = self.settings
        return SnapOrder(
            cameras=settings.check_cameras(cameras),
            blank_light=blank_light,
            exposure_s=settings.exposure_time(self.controls.exposure(exposure_s, settings.exposure.nominal)),
            timeout_s=settings.waits.exposure,
            controls=self.controls.sensors(cameras),
            blank_laser=blank_laser,
        )

    @property
    def cameras(self) -> FrameSource:
        """The cameras.

        Raises:
            StateError: Another process has them.
        """
        if self.source is None:
            raise StateError("the cameras are in another process")
        return self.source

    @property
    def outputs(self) -> Screen:
        """Where images go.

        Raises:
            StateError: Another process has it.
        """
        if self.screen is None:
            raise StateError("the images of the cameras are put out by another process")
        return self.screen

    @property
    def scanner(self) -> LaserRig:
        """The laser scanner.

        Raises:
            StateError: There is none.
        """
        if self.laser is None:
            raise StateError("there is no laser scanner")
        return self.laser
