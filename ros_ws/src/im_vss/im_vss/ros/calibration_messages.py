"""Calibrations of cameras as messages between vision processes: in use, and to be taken into use."""

import threading
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from im_cell.calibration_files import COVARIANCE, EXTRINSICS, change_camera_files, read_calibration
from im_cell.robot import Cell
from im_core.errors import DataError, StoreError
from im_msgs.msg import CalibrationFiles
from im_vss.camera_book import CameraBook

TRUTH = "/vss/calibrations"
"""Latched topic of the calibrations in use."""
TAKE = "/vss/take_calibration"
"""Service that takes calibrations into use."""


def to_message(files: Mapping[str, str], folder: Path) -> CalibrationFiles:
    """Return files, by name, as a message, with the folder that keeps them."""
    return CalibrationFiles(folder=str(folder), names=list(files), contents=list(files.values()))


class CalibrationReader:
    """Reader of calibrations in messages, checked as those in a folder; for any thread.

    Args:
        cell: The cell of the cameras.
        cameras: Those in use.
        folder: Where the files are put for reading.
    """

    def __init__(self, cell: Cell, cameras: Iterable[str], folder: Path) -> None:
        self._cell, self._folder = cell, folder
        self._known = {EXTRINSICS, COVARIANCE, *(f"{camera}.yaml" for camera in cameras)}
        self._reading = threading.Lock()

    def use(self, message: CalibrationFiles, book: CameraBook, kept: Path) -> None:
        """Have `book` use the calibrations of a message, as files of the folder `kept`; none change nothing.

        Raises:
            DataError: A file is none of a camera in use, or wrong.
            StoreError: They cannot be put down for reading.
        """
        if not message.names:
            return
        if set(message.names) - self._known or len(message.names) != len(message.contents):
            given = f"{len(message.contents)} texts for the files {', '.join(message.names)}"
            raise DataError(f"the calibrations have {given}; known are {', '.join(sorted(self._known))}")
        files = dict(zip(message.names, message.contents, strict=True))
        with self._reading:
            try:
                change_camera_files(self._folder, {name: files.get(name) for name in self._known})
            except OSError as error:
                told = f"{self._folder}: cannot be written: {error.strerror}"
                raise StoreError(told, file=str(self._folder), reason=str(error.strerror)) from error
            book.adopt(replace(read_calibration(self._folder, self._cell), folder=kept))
