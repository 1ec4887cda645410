"""What the Vision Services System is built around: its settings, its cameras and its monitors."""

from dataclasses import dataclass, field

from im_core.robot import Cell
from im_vss.camera_book import CameraBook
from im_vss.frames import FrameSource, Screen
from im_vss.monitor import Monitors
from im_vss.settings import VssSettings


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
    """

    settings: VssSettings
    cell: Cell
    book: CameraBook
    source: FrameSource
    screen: Screen
    monitors: Monitors = field(default_factory=Monitors)
