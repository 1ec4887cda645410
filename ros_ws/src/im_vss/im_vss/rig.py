"""What the Vision Services System is built around: its settings, its cameras and its monitors."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from im_core.errors import StateError
from im_core.robot import Cell
from im_vss.camera_book import CameraBook
from im_vss.camera_controls import CameraControls
from im_vss.frames import FrameSource, Screen
from im_vss.laser.book import LaserBook
from im_vss.laser.scanner import Scanner
from im_vss.monitor import Monitors
from im_vss.settings import VssSettings


@dataclass(frozen=True)
class LaserRig:
    """The laser scanner: its driver, and its present calibration."""

    scanner: Scanner
    book: LaserBook


@dataclass(frozen=True)
class Rig:
    """Hardware and settings, as handed to Vision Modules, Tools and Services.

    Attributes:
        settings: Configuration of the Vision Services System.
        cell: Nominal parameters of the cell.
        book: Present calibration of each camera.
        source: The cameras.
        screen: Where images go.
        monitors: Image planes of the display.
        controls: How each camera's sensor is set, and the exposure time that 0 stands for.
        light_position: Where the robot's pose puts the light of calibrations at a testbed time [ns]: place in the
            world, shape (3,) [m]; None if that is not known.
        mount: Where a frame of the robot that carries a camera is now: rotation frame -> world, shape (3, 3), and
            origin, shape (3,) [m]; None if that is not known.
        laser: The laser scanner; None where there is none.
    """

    settings: VssSettings
    cell: Cell
    book: CameraBook
    source: FrameSource
    screen: Screen
    monitors: Monitors = field(default_factory=Monitors)
    controls: CameraControls = field(default_factory=CameraControls)
    light_position: Callable[[int], NDArray[np.float64] | None] = lambda stamp_ns: None
    mount: Callable[[str], tuple[NDArray[np.float64], NDArray[np.float64]] | None] = lambda frame: None
    laser: LaserRig | None = None

    @property
    def scanner(self) -> LaserRig:
        """The laser scanner.

        Raises:
            StateError: There is none.
        """
        if self.laser is None:
            raise StateError("there is no laser scanner")
        return self.laser
