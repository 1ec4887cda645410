"""Camera poses: places of the robot's camera frames at the exposures."""

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence

import numpy as np
import scipy
from numpy.typing import NDArray

from im_core.errors import StateError

Array = NDArray[np.float64]

Pose = tuple[Array, Array]
"""Rotation frame -> world, shape (3, 3), and origin of the frame in the world, shape (3,) [m]."""

MOST_EXPOSURES = 4096
"""Exposures whose poses are known, at most; of more the oldest are forgotten."""

_STILL_M, _STILL_RAD = 1e-3, 1e-3
"""How far the poses of a mount at rest may be apart: far more than the encoders' noise, half a pixel at a metre."""


class Mounts:
    """Places of camera frames at the latest exposures; any thread may note and ask.

    Args:
        now: Where a frame is at a testbed time that has just been [ns]; None: that is not known.
    """

    def __init__(self, now: Callable[[str, int], Pose | None] = lambda frame, stamp_ns: None) -> None:
        self._now = now
        self._lock = threading.Lock()
        self._poses: OrderedDict[tuple[str, int], Pose] = OrderedDict()

    def note(self, frame: str, stamps_ns: Iterable[int]) -> None:
        """Keep the places of a frame at fresh exposures, testbed times [ns]."""
        poses = {(frame, stamp_ns): self._now(frame, stamp_ns) for stamp_ns in stamps_ns}
        with self._lock:
            for exposure, pose in poses.items():
                self._poses.pop(exposure, None)  # of a former incarnation of the testbed, whose time was the same
                if pose is not None:
                    self._poses[exposure] = pose
            while len(self._poses) > MOST_EXPOSURES:
                self._poses.popitem(last=False)

    def at(self, frame: str, stamps_ns: Sequence[int]) -> Pose:
        """Where a frame was at some exposures, at rest.

        Args:
            frame: Its name.
            stamps_ns: Testbed times of the exposures [ns].

        Raises:
            StateError: That is not known of any of them, or the frame moved in between.
        """
        with self._lock:
            poses = [self._poses.get((frame, stamp_ns)) for stamp_ns in stamps_ns]
        return at_rest(frame, [pose for pose in poses if pose is not None])


def at_rest(frame: str, poses: Sequence[Pose]) -> Pose:
    """The last of a frame's poses, where all are the same.

    Raises:
        StateError: There is none, or they are not the same.
    """
    if not poses:
        raise StateError(f"the pose of {frame} during the exposure of its cameras is not known", frame=frame)
    rotation, origin = poses[-1]
    shift = max(float(np.linalg.norm(there - origin)) for _, there in poses)
    turns = scipy.spatial.transform.Rotation.from_matrix([rotation.T @ turned for turned, _ in poses])
    turn = float(turns.magnitude().max())
    if shift > _STILL_M or turn > _STILL_RAD:
        told = f"{frame} moved between the exposures, by {1e3 * shift:.1f} mm and {1e3 * turn:.1f} mrad"
        raise StateError(told, frame=frame, shift=shift, turn=turn)
    return poses[-1]
