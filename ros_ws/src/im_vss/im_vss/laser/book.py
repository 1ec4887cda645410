"""The present calibration of the laser scanner: as drawn until something better is set."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from im_core.errors import DataError
from im_core.laser_model import LaserModel
from im_core.robot.scenery import LaserScanner

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LaserEntry:
    """Model of the scanner, and its file; None: it is taken as the drawing has it."""

    model: LaserModel
    file: Path | None = None

    @property
    def calibrated(self) -> bool:
        """Whether it was calibrated since the start."""
        return self.file is not None


class LaserBook:
    """Keeps the calibration, and writes it to a file."""

    def __init__(self, sheet: LaserScanner, directory: Path) -> None:
        """Start from the drawing.

        Args:
            sheet: The scanner as drawn.
            directory: Where the file goes.
        """
        rotation, position = sheet.pose()
        self._entry = LaserEntry(LaserModel(rotation, position, sheet.gap))
        self._directory = directory
        self._lock = threading.Lock()
        self.on_change: Callable[[], None] = lambda: None

    @property
    def entry(self) -> LaserEntry:
        """What is known of the scanner."""
        with self._lock:
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
        path = self._directory / "laser.yaml"
        content = {
            "rotation": model.rotation.tolist(),
            "position": model.position.tolist(),
            "gain": list(map(float, model.gain)),
            "offset": float(model.offset),
            "gap": float(model.gap),
            "covariance": covariance.tolist(),
        }
        try:
            self._directory.mkdir(parents=True, exist_ok=True)
            path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
        except OSError as error:
            raise DataError(f"{path}: cannot be written: {error.strerror}", file=str(path)) from error
        with self._lock:
            self._entry = LaserEntry(model, path)
        self.on_change()
        return path
