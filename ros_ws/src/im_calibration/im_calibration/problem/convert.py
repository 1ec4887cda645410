"""Data sets from other programs: spots and positions as lines of text, or as matrices of OpenCV."""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, model_validator

from im_calibration.problem.dataset import SCHEMA
from im_cell.calibration_files.intrinsics import plain_yaml
from im_core.config import FieldError, Model, parse_model
from im_core.errors import DataError
from im_core.files import MEBIBYTE, read_text

Array = NDArray[np.float64]

_LARGEST_FILE = 100 * MEBIBYTE


@dataclass(frozen=True)
class Sighting:
    """Spots seen by one camera, with the seen positions.

    Attributes:
        spots: Where, shape (n, 2) [px].
        positions: Of what, as the file has them, shape (n, 3).
        image_size: Width and height [px]; None where the file does not say.
    """

    spots: Array
    positions: Array
    image_size: tuple[int, int] | None = None


@dataclass(frozen=True)
class BoardSighting:
    """Views of a chessboard by one camera.

    Attributes:
        spots: Corners, row by row, shape (k, p, 2) [px].
        points: Places on the board, shape (p, 3), in the unit of the file.
        image_size: Width and height [px]; None where the file does not say.
    """

    spots: Array
    points: Array
    image_size: tuple[int, int] | None


def read_lines(path: Path) -> Sighting:
    """Lines ``u v x y z``, separated by blanks, tabs, commas or semicolons; a # begins a comment.

    Raises:
        DataError: It cannot be read, or a line is none of these; file and line are named.
    """
    rows = []
    for number, line in enumerate(read_text(path, _LARGEST_FILE).splitlines(), 1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        words = re.split(r"[\s,;]+", content)
        if len(words) != 5:
            raise _wrong(path, number, f"{len(words)} numbers, the 5 of u v x y z are needed")
        try:
            row = [float(word) for word in words]
        except ValueError:
            raise _wrong(path, number, f"'{content[:60]}' is not five numbers u v x y z") from None
        if not np.all(np.isfinite(row)):
            raise _wrong(path, number, "a number is not finite")
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: holds no line u v x y z.", file=str(path))
    table = np.array(rows)
    return Sighting(table[:, :2], table[:, 2:])


class _Matrix(Model):
    """Matrix as written by ``cv::FileStorage``, row by row; ``dt: 2f`` means: each element is two numbers."""

    rows: Annotated[int, Field(ge=1)]
    cols: Annotated[int, Field(ge=1)]
    dt: Annotated[str, Field(pattern=r"^[1-9]?[a-z]$")]
    data: list[float]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        count = self.rows * self.cols * self._channels
        if len(self.data) != count:
            size = f"{self.rows} x {self.cols} of dt {self.dt}"
            raise FieldError(("data",), f"has {len(self.data)} numbers, the {count} of {size} are needed")
        return self

    @property
    def _channels(self) -> int:
        return int(self.dt[:-1] or 1)

    def holds(self, size: int) -> bool:
        """Check whether the rows, or the elements, are vectors of the given size."""
        return self._channels == size or (self._channels == 1 and self.cols == size)

    def vectors(self, size: int) -> Array:
        """The vectors, shape (n, size)."""
        return np.array(self.data, dtype=float).reshape(-1, size)


class _OpenCvFile(Model):
    """OpenCV file of one camera: image points with the imaged points, or with the size of a board, a view a row."""

    model_config = ConfigDict(extra="ignore")

    image_width: Annotated[int, Field(ge=1)] | None = None
    image_height: Annotated[int, Field(ge=1)] | None = None
    image_points: _Matrix
    object_points: _Matrix | None = None
    board_width: Annotated[int, Field(ge=2, le=100)] | None = None
    board_height: Annotated[int, Field(ge=2, le=100)] | None = None
    square_size: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _fit(self) -> Self:
        if self.object_points is None:
            if None in (self.board_width, self.board_height, self.square_size):
                told = "is missing, and so are board_width, board_height and square_size of OpenCV's sample"
                raise FieldError(("object_points",), told)
            corners = int(self.board_width or 0) * int(self.board_height or 0)
            if not self.image_points.holds(2) or self.image_points.cols != corners:
                shape = f"{self.image_points.rows} x {self.image_points.cols} of dt {self.image_points.dt}"
                told = f"is {shape}; a row of {corners} elements of 2 for each view is needed"
                raise FieldError(("image_points", "cols"), told)
            return self
        for name, matrix, size in (("image_points", self.image_points, 2), ("object_points", self.object_points, 3)):
            if not matrix.holds(size):
                shape = f"{matrix.rows} x {matrix.cols} of dt {matrix.dt}"
                raise FieldError(
                    (name, "cols"), f"is {shape}; n x {size}, or elements of {size} (dt {size}f), are needed"
                )
        spots, points = len(self.image_points.data) // 2, len(self.object_points.data) // 3
        if spots != points:
            raise FieldError(("object_points", "data"), f"holds {points} points, image_points holds {spots}")
        return self


def read_opencv(path: Path) -> Sighting | BoardSighting:
    """Read YAML of ``cv::FileStorage`` with ``image_points``, ``object_points``, ``image_width``, ``image_height``.

    In place of ``object_points`` may be ``board_width``, ``board_height`` and ``square_size``, as OpenCV's own sample
    of a calibration writes.

    Raises:
        ConfigError: It is no such file; file and line are named.
        DataError: It cannot be read.
    """
    found = parse_model(plain_yaml(read_text(path, _LARGEST_FILE)), _OpenCvFile, str(path))
    size = (found.image_width, found.image_height) if found.image_width and found.image_height else None
    if found.object_points is not None:
        return Sighting(found.image_points.vectors(2), found.object_points.vectors(3), size)
    columns, rows = int(found.board_width or 0), int(found.board_height or 0)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    flat = np.column_stack((x.ravel(), y.ravel(), np.zeros(x.size)))
    points = np.asarray(float(found.square_size or 0.0) * flat, dtype=np.float64)
    return BoardSighting(found.image_points.vectors(2).reshape(-1, columns * rows, 2), points, size)


def dataset_from(
    sightings: Mapping[str, Sighting],
    image_size: tuple[int, int] | None,
    metres: float,
    sigma_px: float | None,
    sigma_m: float | None,
) -> dict[str, Any]:
    """Build a data set from the sightings of cameras; spots of the same position, to the last digit, are of one pose.

    Args:
        sightings: By name of the camera.
        image_size: Width and height of images whose file does not say it [px].
        metres: Length of the unit of the positions [m].
        sigma_px: Standard deviation of each image coordinate [px]; None: not known.
        sigma_m: Standard deviation of each coordinate of the positions [m]; None: not known, 0: exact.

    Raises:
        DataError: The size of an image is not known.
    """
    keys = {name: _keys(sighting.positions) for name, sighting in sightings.items()}
    poses = list(dict.fromkeys(key for each in keys.values() for key in each))
    seen = []
    for name, sighting in sightings.items():
        spots = dict(zip(keys[name], sighting.spots.tolist(), strict=True))
        seen.append([spots.get(pose) for pose in poses])
    sizes = {name: sighting.image_size or image_size for name, sighting in sightings.items()}
    positions = [[metres * value for value in pose[:3]] for pose in poses]
    return {**dataset_head(sizes, len(poses), sigma_px, sigma_m), "trials": [{"x_base_m": positions, "u_px": seen}]}


def dataset_from_boards(
    sightings: Mapping[str, BoardSighting],
    image_size: tuple[int, int] | None,
    metres: float,
    sigma_px: float | None,
) -> dict[str, Any]:
    """Build a data set from views of one board; views of several cameras belong together by their number.

    Args:
        sightings: By name of the camera.
        image_size: Width and height of images whose file does not say it [px].
        metres: Length of the unit of the board [m].
        sigma_px: Standard deviation of each image coordinate [px]; None: not known.

    Raises:
        DataError: The size of an image is not known, the boards differ, or the cameras have not the same views.
    """
    first, *others = sightings.values()
    for other in others:
        if not np.array_equal(first.points, other.points) or first.spots.shape != other.spots.shape:
            raise DataError("The files of the cameras have boards of different sizes, or not the same number of views.")
    head = dataset_head(
        {name: each.image_size or image_size for name, each in sightings.items()}, 0, sigma_px, sigma_m=None
    )
    spots = np.stack([each.spots for each in sightings.values()])
    sigma = None if sigma_px is None else np.full(spots.shape[:3], sigma_px).tolist()
    target = {"points_m": (metres * first.points).tolist(), "u_px": spots.tolist(), "sigma_u_px": sigma}
    return {name: head[name] for name in ("schema", "camera_names", "image_size")} | {"target": target}


def dataset_head(
    image_sizes: Mapping[str, tuple[int, int] | None], n: int, sigma_px: float | None, sigma_m: float | None
) -> dict[str, Any]:
    """Return a data set of n poses without trials.

    Args:
        image_sizes: Width and height of the images of each camera [px]; None: not known.
        n: How many poses.
        sigma_px: Standard deviation of each image coordinate [px]; None: not known.
        sigma_m: Standard deviation of each coordinate of the positions [m]; None: not known, 0: exact.

    Raises:
        DataError: The size of an image is not known.
    """
    unsized = [name for name, size in image_sizes.items() if not size]
    if unsized:
        raise DataError(f"The image size of {', '.join(unsized)} is not known; give --image-size WIDTHxHEIGHT.")
    return {
        "schema": SCHEMA,
        "camera_names": list(image_sizes),
        "image_size": [list(size) for size in image_sizes.values() if size],
        "sigma_u_px": None if sigma_px is None else [[sigma_px] * n] * len(image_sizes),
        "cov_x_m2": None if sigma_m is None else [(sigma_m**2 * np.eye(3)).tolist()] * n,
    }


def _keys(positions: Array) -> Sequence[tuple[float, ...]]:
    """Return each position with the count of earlier occurrences."""
    before: Counter[tuple[float, ...]] = Counter()
    keys = []
    for position in map(tuple, positions.tolist()):
        keys.append((*position, float(before[position])))
        before[position] += 1
    return keys


def _wrong(path: Path, line: int, sentence: str) -> DataError:
    return DataError(f"{path}:{line}: {sentence}.", file=str(path), line=line)
