"""The present calibration of the laser scanner: as drawn until something better is set."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from im_cell.calibration_files import LASER, CalibrationFiles, LaserEstimate, laser_yaml
from im_cell.laser_model import LaserModel
from im_cell.robot import LaserScanner
from im_core.errors import DataError
from im_core.files import make_folder, write_whole

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LaserEntry:
    """Model of the scanner, and the file; None: the drawing's model."""

    model: LaserModel
    file: Path | None = None

    @property
    def calibrated(self) -> bool:
        """Whether a calibration replaces the drawing's model."""
        return self.file is not None

    def told(self) -> str:
        """Return the origin of the calibration, as a sentence."""
        return f"laser scanner: {self.origin}"

    @property
    def origin(self) -> str:
        """File of the calibration, or the drawing."""
        return str(self.file or "as drawn")


class LaserBook:
    """Keeper of the calibration and the file."""

    def __init__(self, sheet: LaserScanner, directory: Path) -> None:
        """Start from the drawing."""
        rotation, position = sheet.pose()
        self._entry = LaserEntry(LaserModel(rotation, position, sheet.gap))
        self._directory = directory
        self._changing = threading.Lock()
        self.on_change: Callable[[], None] = lambda: None

    @property
    def entry(self) -> LaserEntry:
        """The present model of the scanner."""
        return self._entry

    def set(self, model: LaserModel, covariance: Array) -> Path:
        """Use a calibration from now on.

        Args:
            model: The estimate.
            covariance: Of its ten parameters, see :mod:`im_vss.laser.calibration`, shape (10, 10).

        Returns:
            The file that was written.

        Raises:
            DataError: It cannot be written; nothing has changed then.
        """
        path = self._directory / LASER
        self._change(LaserEntry(model, path), LaserEstimate(model, covariance))
        return path

    def adopt(self, files: CalibrationFiles) -> None:
        """Use the calibration of an earlier run, if present, and write the calibration in use now.

        Raises:
            DataError: It cannot be written; nothing has changed then.
        """
        if files.laser is not None:
            self._change(LaserEntry(files.laser.model, files.folder / LASER), files.laser)

    def _change(self, entry: LaserEntry, estimate: LaserEstimate) -> None:
        path = self._directory / LASER
        with self._changing:
            try:
                make_folder(self._directory)
                write_whole(path, laser_yaml(estimate))
            except OSError as error:
                raise DataError(f"{path}: cannot be written: {error.strerror}", file=str(path)) from error
            self._entry = entry
        self.on_change()
