"""The fiducials' codes: ArUco 4X4_50 of OpenCV."""

import cv2
import numpy as np
from numpy.typing import NDArray

DICTIONARY = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
CELLS = 6
"""Cells along a side, the black border included."""


def code_of(number: int) -> NDArray[np.bool_]:
    """Which cells of a fiducial are white, its upper left first, shape (6, 6)."""
    return np.asarray(cv2.aruco.generateImageMarker(DICTIONARY, number, CELLS) > 0)
