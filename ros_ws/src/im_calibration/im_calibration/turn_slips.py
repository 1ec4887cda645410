"""Slips in rotations and axes, common to data of lights and to poses of robots."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_QUATERNIONS = (([1, 2, 3, 0], "x, y, z, w", "w, x, y, z"), ([3, 0, 1, 2], "w, x, y, z", "x, y, z, w"))
"""Where the numbers in their own order stand in those read, how they were read, and how they may be meant."""
_EULER = (("ZYX", "XYZ"), ("XYZ", "ZYX"), ("ZYX", "zyx"), ("XYZ", "xyz"), ("ZYX", "xyz"))
"""How Euler angles were read, and how they may be meant, capital letters about moving axes; others say the same."""

_UNIT, _LETTERS = np.eye(3), "xyz"


@dataclass(frozen=True)
class TurnSlip:
    """Rotations that were written in one form and read in another.

    Attributes:
        numbers: Their numbers: quaternions or Euler angles.
        own: The order in which these were written.
        read: The order in which these were read.
        turns: The rotations as written, shape (n, 3, 3).
    """

    numbers: str
    own: str
    read: str
    turns: Array


def turn_slips(turns: Array) -> Iterator[TurnSlip]:
    """Yield slips in the order of quaternions and Euler angles.

    Args:
        turns: Rotations as read, shape (n, 3, 3).
    """
    from scipy.spatial.transform import Rotation  # loads for a third of a second, and few data sets have slips

    given = Rotation.from_matrix(turns)
    quaternions = given.as_quat()
    for order, read, own in _QUATERNIONS:
        yield TurnSlip("quaternions", own, read, Rotation.from_quat(quaternions[:, order]).as_matrix())
    for read, own in _EULER:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # where two axes are one, any share of the turn is as good
            angles = given.as_euler(read)
        turned = Rotation.from_euler(own, angles).as_matrix()
        yield TurnSlip("Euler angles", _in_words(own), _in_words(read), turned)


def _in_words(order: str) -> str:
    return f"about {'moving' if order.isupper() else 'fixed'} {', '.join(order.lower())}"


def mirrored_axes() -> Iterator[tuple[str, Array]]:
    """Yield changes of places to left-handed axes, a phrase and a matrix each."""
    for i, letter, others in _axes():
        yield f"{letter} reversed", _UNIT - 2.0 * np.outer(_UNIT[i], _UNIT[i])
        yield f"{others} exchanged", _UNIT[[i if k == i else 3 - i - k for k in range(3)]]


def turned_axes() -> Iterator[tuple[str, Array]]:
    """Yield changes of places to other right-handed axes, a phrase and a matrix each."""
    for i, _, others in _axes():
        yield f"{others} reversed", 2.0 * np.outer(_UNIT[i], _UNIT[i]) - _UNIT
    for order in ((1, 2, 0), (2, 0, 1)):
        yield f"x, y, z taken from {', '.join(_LETTERS[i] for i in order)}", _UNIT[list(order)]


def _axes() -> Iterator[tuple[int, str, str]]:
    """Yield each axis: number, letter, and the letters of both others."""
    for i, letter in enumerate(_LETTERS):
        yield i, letter, " and ".join(_LETTERS.replace(letter, ""))
