"""The shipped pair of PUMA arms by their Denavit-Hartenberg rows: an independent reference for its URDF.

P.I. Corke, B. Armstrong-Helouvry, ICRA 1994; d3, a3, d4 of the 600 from K.S. Fu, R.C. Gonzalez, C.S.G. Lee, 1987.
"""

from math import cos, pi, sin

import numpy as np

#: d, a, alpha of each row [m, m, rad]
ROWS = {
    "left": ((0.67183, 0.0, pi / 2), (0.0, 0.4318, 0.0), (0.15005, 0.0203, -pi / 2), (0.4318, 0.0, pi / 2),
             (0.0, 0.0, -pi / 2), (0.0, 0.0, 0.0)),
    "right": ((0.67183, 0.0, pi / 2), (0.0, 0.4318, 0.0), (0.14909, 0.02032, -pi / 2), (0.43307, 0.0, pi / 2),
              (0.0, 0.0, -pi / 2), (0.0, 0.0, 0.0)),
}  # fmt: skip
#: heights of track, rotation, tilt and arm above what is below [m]
HEIGHTS = (0.14, 0.06, 0.05, 0.08)


def wrist_pose(side, q):
    """Pose of the last row's frame at positions of cart and arm, shape (9,) -> (4, 4): the product of the rows."""
    track, rotation, tilt, *arm = q
    low, turntable, axis, mount = HEIGHTS
    pose = _step(np.eye(3), (track, 0.0, low + turntable)) @ _step(_about(2, rotation), (0.0, 0.0, 0.0))
    pose = pose @ _step(np.eye(3), (0.0, 0.0, axis)) @ _step(_about(1, tilt), (0.0, 0.0, 0.0))
    pose = pose @ _step(np.eye(3), (0.0, 0.0, mount))
    for (d, a, alpha), theta in zip(ROWS[side], arm, strict=True):
        c, s, ca, sa = cos(theta), sin(theta), cos(alpha), sin(alpha)
        row = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0.0, sa, ca, d], [0.0, 0.0, 0.0, 1.0]]
        pose = pose @ np.array(row)
    return pose


def _step(rotation, translation):
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = rotation, translation
    return step


def _about(axis, angle):
    c, s = cos(angle), sin(angle)
    i, j = [k for k in range(3) if k != axis]
    turn = np.eye(3)
    turn[i, i] = turn[j, j] = c
    turn[i, j], turn[j, i] = (-s, s) if axis != 1 else (s, -s)
    return turn
