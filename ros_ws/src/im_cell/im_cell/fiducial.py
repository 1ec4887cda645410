"""The codes of the printed fiducials: ArUco 4X4_50, as in OpenCV."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

CELLS = 6
"""Cells along a side, the black border included."""

_CODES = (
    0xB532, 0x0F9A, 0x332D, 0x9946, 0x549E, 0x79CD, 0x9E2E, 0xC4F2, 0xFEDA, 0xCF56, 0xF991, 0x11A7, 0x0EB7, 0x2A0F,
    0x24B1, 0x263E, 0x4665, 0x6600, 0x6C5E, 0x76AF, 0x868B, 0xB02B, 0xCCD5, 0xDD82, 0xFE47, 0x9471, 0xACE4, 0xA554,
    0x2123, 0x346F, 0x4415, 0x57B2, 0x9ECF, 0xF0CB, 0x08AE, 0x0929, 0x1875, 0x04FF, 0x0DF6, 0x1C5A, 0x1718, 0x2A28,
    0x328C, 0x38B2, 0x24E8, 0x2EEB, 0x2D3F, 0x4B64, 0x502E, 0x5013,
)  # fmt: skip
"""The inner 4 x 4 cells of each, row by row from the upper left, 1 for white."""


@cache
def code_of(number: int) -> NDArray[np.bool_]:
    """Return the white cells of a fiducial as True, the upper left cell first, shape (6, 6)."""
    code = np.zeros((CELLS, CELLS), dtype=bool)
    code[1:-1, 1:-1] = (_CODES[number] >> np.arange(15, -1, -1)).reshape(4, 4) & 1
    code.setflags(write=False)
    return code
