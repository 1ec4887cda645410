"""Poses of a robot from a file: lines of numbers, or YAML."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from im_cell.rotations import matrix_of_quaternion
from im_core.config import Model, load_model
from im_core.errors import DataError
from im_core.files import MEBIBYTE, read_text

Array = NDArray[np.float64]

ORDERS = ("xyzw", "wxyz")
"""Orders of quaternions."""

_LARGEST_FILE = 50 * MEBIBYTE
_UNIT, _RIGID = 0.02, 1e-2
_LARGEST_M = 100.0


class _Pose(Model):
    """Place with a quaternion x, y, z, w, or a matrix of 4 x 4, for the image of a name."""

    name: str = ""
    position_m: Annotated[list[float], Field(min_length=3, max_length=3)] | None = None
    orientation_xyzw: Annotated[list[float], Field(min_length=4, max_length=4)] | None = None
    matrix: list[list[float]] | None = None

    @model_validator(mode="after")
    def _one(self) -> Self:
        if (self.matrix is None) == (self.position_m is None or self.orientation_xyzw is None):
            raise ValueError("needs position_m and orientation_xyzw, or matrix")
        return self


class _Poses(Model):
    """File of poses."""

    frame: str = ""
    poses: Annotated[list[_Pose], Field(min_length=1)]


def read_poses(path: Path, names: Sequence[str], order: str | None, metres: float) -> dict[str, Array]:
    """Return the poses of the robot for images.

    Lines hold, after the name of the image or without any name, ``x y z`` and a quaternion, or 12 or 16 numbers of a
    matrix, row by row; between them are blanks, tabs, commas or semicolons; a # begins a comment. YAML has ``poses``, a
    list with ``name``, ``position_m`` and ``orientation_xyzw``, or ``matrix``. Without names, poses belong to the
    images in the order of their names.

    Args:
        path: The file.
        names: Names of the images, in order.
        order: Order of the quaternions of lines, of :data:`ORDERS`; None: not told.
        metres: Length of the unit of places [m].

    Returns:
        The poses of the images that have one, by name, shape (4, 4) each [-], [m].

    Raises:
        ConfigError: It is YAML, and not of this form.
        DataError: It cannot be read, a line is none of these, or no image has a pose; file and line are named.
    """
    if path.suffix in (".yaml", ".yml"):
        content = load_model(path, _Poses).poses
        rows = [(pose.name, _of_yaml(pose), f"{path}: poses[{i}]") for i, pose in enumerate(content)]
    else:
        rows = _lines(path, order)
    poses = [_checked(numbers, order or "xyzw", where, metres) for _, numbers, where in rows]
    given = [name for name, _, _ in rows]
    if all(given):
        by_name = dict(zip((Path(name).stem for name in given), poses, strict=True))
        found = {name: by_name[name] for name in names if name in by_name}
        if not found:
            raise DataError(f"{path}: has no pose for any of the images {', '.join(names[:3])}...", file=str(path))
        return found
    if len(poses) != len(names):
        raise DataError(
            f"{path}: has {len(poses)} poses for {len(names)} images; begin the lines with the images' names.",
            file=str(path),
        )
    return dict(zip(names, poses, strict=True))


def _lines(path: Path, order: str | None) -> list[tuple[str, list[float], str]]:
    rows = list[tuple[str, list[float], str]]()
    for number, line in enumerate(read_text(path, _LARGEST_FILE).splitlines(), 1):
        words = re.split(r"[\s,;]+", line.partition("#")[0].strip())
        if words == [""]:
            continue
        where = f"{path}:{number}"
        name = "" if _is_number(words[0]) else words.pop(0)
        if not all(map(_is_number, words)):
            if not rows:
                continue  # names of the columns
            raise DataError(f"{where}: '{line.strip()[:60]}' are no numbers.", file=str(path), line=number)
        if len(words) not in (7, 12, 16):
            told = f"has {len(words)} numbers; 7 (place, quaternion), 12 or 16 (matrix) are needed"
            raise DataError(f"{where}: {told}.", file=str(path), line=number)
        if len(words) == 7 and order is None:
            raise DataError(f"{where}: tell the order of the quaternions: --order xyzw or --order wxyz.", line=number)
        rows.append((name, [float(word) for word in words], where))
    if not rows:
        raise DataError(f"{path}: holds no poses.", file=str(path))
    return rows


def _of_yaml(pose: _Pose) -> list[float]:
    if pose.matrix is not None:
        return [value for row in pose.matrix for value in row]
    return [*(pose.position_m or ()), *(pose.orientation_xyzw or ())]


def _checked(numbers: list[float], order: str, where: str, metres: float) -> Array:
    pose = np.eye(4)
    if not np.all(np.isfinite(numbers)):
        raise DataError(f"{where}: a number is not finite.")
    if len(numbers) == 7:
        quaternion = np.array(numbers[3:])
        if abs(np.linalg.norm(quaternion) - 1.0) > _UNIT:
            raise DataError(
                f"{where}: the quaternion has length {np.linalg.norm(quaternion):.3g}, it must be 1; the place x y z "
                "comes first."
            )
        quaternion = np.roll(quaternion, -1) if order == "wxyz" else quaternion
        pose[:3, :3] = matrix_of_quaternion(quaternion / np.linalg.norm(quaternion))
        pose[:3, 3] = numbers[:3]
    elif len(numbers) in (12, 16):
        pose[: len(numbers) // 4] = np.reshape(numbers, (-1, 4))
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > _RIGID or np.linalg.det(pose[:3, :3]) < 0.0:
            raise DataError(f"{where}: the matrix has no rotation in its first three columns; row by row is needed.")
        u, _, vt = np.linalg.svd(pose[:3, :3])
        pose[:3, :3] = u @ vt
    else:
        raise DataError(f"{where}: the matrix has {len(numbers)} numbers, 12 or 16 are needed.")
    pose[:3, 3] *= metres
    if np.abs(pose[:3, 3]).max() > _LARGEST_M:
        raise DataError(f"{where}: the place is {np.abs(pose[:3, 3]).max():.3g} m away; is it in mm (--unit mm)?")
    return pose


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
