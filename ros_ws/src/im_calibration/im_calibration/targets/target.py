"""Calibration targets by name: chessboard, ChArUco board, grid of AprilTags or ArUco markers, grids of circles."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field

from im_cell.robot import Cell
from im_core.config import Model, load_model
from im_core.errors import DataError, NotFoundError, nearest

Array = NDArray[np.float64]

_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "in": 0.0254}
_LARGEST_COUNT, _LARGEST_SIZE_M = 100, 10.0
_FORMS = {
    "chessboard": "chessboard:COLUMNSxROWS:SQUARE, counted in inner corners",
    "charuco": "charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, counted in squares",
    "tags": "tags:COLUMNSxROWS:TAG:GAP:DICTIONARY",
    "circles": "circles:COLUMNSxROWS:DISTANCE",
    "asymmetric_circles": "asymmetric_circles:COLUMNSxROWS:DISTANCE, the distance between rows",
}
FEWEST_POINTS = 8
"""How many points of a target have to be seen in an image."""
_KALIBR_TAGS = "APRILTAG_36H11"
STANDARD_TAGS = "TAGSTANDARD41H12"
"""AprilTags of the third version, which have bits outside of their border; their size is that of the border."""
DICTIONARIES = (
    *(f"{size}X{size}_{count}" for size in (4, 5, 6, 7) for count in (50, 100, 250, 1000)),
    *("APRILTAG_16H5", "APRILTAG_25H9", "APRILTAG_36H10", _KALIBR_TAGS, "ARUCO_ORIGINAL", "ARUCO_MIP_36H12"),
    STANDARD_TAGS,
)
"""Dictionaries of markers, by the names that OpenCV has for them, without DICT_, and one that it does not have."""


@dataclass(frozen=True)
class CalibrationTarget:
    """Flat target of a known size.

    Attributes:
        kind: One of chessboard, charuco, tags, circles, asymmetric_circles.
        columns: How many inner corners, squares, tags or circles are in a row.
        rows: How many rows.
        size: Side of a square or tag, or distance of circles [m].
        part: Side of the markers of a ChArUco board, or gap between tags [m].
        dictionary: Of :data:`DICTIONARIES`, where there are markers.
        upwards: Whether rows of tags are counted from the bottom, as Kalibr does.
    """

    kind: str
    columns: int
    rows: int
    size: float
    part: float = 0.0
    dictionary: str = ""
    upwards: bool = False

    def __post_init__(self) -> None:
        """Check the sizes.

        Raises:
            DataError: A number cannot be; it is named.
        """
        fewest = 1 if self.kind == "tags" else 2
        for name, count in (("columns", self.columns), ("rows", self.rows)):
            if not fewest <= count <= _LARGEST_COUNT:
                raise DataError(f"The target has {count} {name}, {fewest} to {_LARGEST_COUNT} are possible.")
        for side in (self.size, self.part) if self.dictionary else (self.size,):
            if not 0.0 < side <= _LARGEST_SIZE_M:
                raise DataError(f"A length of the target is {side:g} m, it must be > 0 and at most 10 m; is it in mm?")
        if self.kind == "charuco" and self.part >= self.size:
            raise DataError(
                f"The markers of the ChArUco board have {1e3 * self.part:g} mm, they must be smaller than its squares "
                f"of {1e3 * self.size:g} mm."
            )
        if self.kind == "charuco" and self.dictionary == STANDARD_TAGS:
            raise DataError(f"A ChArUco board has no markers of {STANDARD_TAGS}; these are for tags.")
        if (count := len(self.points)) < FEWEST_POINTS:
            raise DataError(f"The target has {count} points, at least {FEWEST_POINTS} are needed; take a larger one.")

    @property
    def points(self) -> Array:
        """Points in the frame of the target, z = 0, shape (p, 3) [m]; of tags, the four corners of each."""
        columns, rows, size = self.columns, self.rows, self.size
        if self.kind == "charuco":
            columns, rows = columns - 1, rows - 1
        x, y = (part.ravel().astype(float) for part in np.meshgrid(np.arange(columns), np.arange(rows)))
        if self.kind == "asymmetric_circles":
            flat = np.column_stack(((2.0 * x + y % 2.0) * size, y * size))
        elif self.kind == "tags":
            first = np.column_stack((x, y)) * (size + self.part)
            corners = size * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
            if self.upwards:
                corners = corners[[3, 2, 1, 0]]
            flat = (first[:, None] + corners).reshape(-1, 2)
        else:
            flat = np.column_stack((x, y)) * size
        return np.column_stack((flat, np.zeros(len(flat))))

    @property
    def turns_to_itself(self) -> bool:
        """Whether the target looks the same when turned by half."""
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 0
        return self.kind == "circles" or (self.kind == "asymmetric_circles" and self.rows % 2 == 1)

    def __str__(self) -> str:
        """The target in the form of :func:`target_of`."""
        parts = [self.kind, f"{self.columns}x{self.rows}", f"{self.size:.9g}m"]
        return ":".join(parts + ([f"{self.part:.9g}m", self.dictionary] if self.dictionary else []))


class _KalibrTarget(Model):
    """File of a target for Kalibr."""

    model_config = ConfigDict(extra="ignore")

    target_type: Literal["checkerboard", "aprilgrid", "circlegrid"]
    columns: Annotated[int, Field(alias="targetCols", ge=2)] = 0
    rows: Annotated[int, Field(alias="targetRows", ge=2)] = 0
    tag_columns: Annotated[int, Field(alias="tagCols", ge=1)] = 0
    tag_rows: Annotated[int, Field(alias="tagRows", ge=1)] = 0
    tag_size: Annotated[float, Field(alias="tagSize", gt=0)] = 0.0
    tag_spacing: Annotated[float, Field(alias="tagSpacing", gt=0)] = 0.0
    row_spacing: Annotated[float, Field(alias="rowSpacingMeters", gt=0)] = 0.0
    column_spacing: Annotated[float, Field(alias="colSpacingMeters", gt=0)] = 0.0
    spacing: Annotated[float, Field(alias="spacingMeters", gt=0)] = 0.0
    asymmetric: Annotated[bool, Field(alias="asymmetricGrid")] = False

    @property
    def target(self) -> CalibrationTarget:
        """The target.

        Raises:
            DataError: It cannot be.
        """
        if self.target_type == "aprilgrid":
            gap = self.tag_size * self.tag_spacing
            return CalibrationTarget("tags", self.tag_columns, self.tag_rows, self.tag_size, gap, _KALIBR_TAGS, True)
        if self.target_type == "circlegrid":
            kind = "asymmetric_circles" if self.asymmetric else "circles"
            return CalibrationTarget(kind, self.columns, self.rows, self.spacing)
        if not np.isclose(self.row_spacing, self.column_spacing, rtol=1e-9):
            raise DataError("rowSpacingMeters and colSpacingMeters differ, the squares must be square.")
        return CalibrationTarget("chessboard", self.columns, self.rows, self.row_spacing)


def target_of(text: str) -> CalibrationTarget:
    """Return the target of a text such as ``chessboard:9x6:25mm``, or of a file made for Kalibr.

    Args:
        text: Kind, counts and lengths between colons; lengths have their unit, mm, cm, m or in.

    Raises:
        ConfigError: It is a file, and no target of Kalibr.
        DataError: It is no target; the form of the kind is told.
    """
    if text.endswith((".yaml", ".yml")):
        content = load_model(Path(text), _KalibrTarget)
        try:
            return content.target
        except DataError as error:
            raise DataError(f"{text}: {error.message}", file=text) from error
    kind, *parts = text.split(":")
    if kind not in _FORMS:
        raise DataError(f"'{kind}' is no target{nearest(kind, _FORMS)}; there are {', '.join(_FORMS)}.", target=text)
    names = _FORMS[kind].split(", ")[0].split(":")[1:]
    counts = re.fullmatch(r"(\d{1,4})x(\d{1,4})", parts[0]) if parts else None
    if counts is None or len(parts) != len(names):
        raise DataError(f"'{text}' is not of the form {_FORMS[kind]}.", target=text)
    columns, rows = int(counts[1]), int(counts[2])
    size, part = _length(parts[1], text), _length(parts[2], text) if len(parts) > 2 else 0.0
    dictionary = parts[3].upper().removeprefix("DICT_") if len(parts) > 3 else ""
    dictionary = re.sub(r"\ATAG(\d+H\d+)\Z", r"APRILTAG_\1", re.sub(r"\ASTANDARD", "TAGSTANDARD", dictionary))
    if dictionary and dictionary not in DICTIONARIES:
        raise DataError(f"'{parts[3]}' is no dictionary of markers; there are {', '.join(DICTIONARIES)}.", target=text)
    return CalibrationTarget(kind, columns, rows, size, part, dictionary)


def chessboard_of(cell: Cell, name: str) -> CalibrationTarget:
    """Return a chessboard of the cell.

    Raises:
        NotFoundError: The cell has no chessboard of that name.
    """
    boards = {target.name: target for target in cell.targets if target.kind == "chessboard"}
    if name not in boards:
        raise NotFoundError(kind="chessboard", name=name, known=boards)
    return CalibrationTarget("chessboard", *boards[name].corners, boards[name].size)


def _length(text: str, whole: str) -> float:
    found = re.fullmatch(r"(\d+\.?\d*|\.\d+)(mm|cm|m|in)", text)
    if not found:
        raise DataError(f"'{text}' of '{whole}' is no length with a unit, such as 25mm.", target=whole)
    return float(found[1]) * _UNITS[found[2]]
