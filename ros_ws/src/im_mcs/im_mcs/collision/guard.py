"""Collision monitor of the configuration, and its faults as errors with the name."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_core.errors import FOREIGN, ImError
from im_mcs.collision.braking_distance import Ahead
from im_mcs.collision.monitor import CollisionMonitor, Proximity
from im_mcs.collision.surroundings import CollisionScene
from im_mcs.limits.configuration import Collision
from im_mcs.limits.motion_limits import MotionLimits
from im_mcs.model import CellModel


class CollisionMonitorError(ImError):
    """Collision monitor with an error, or with a wrong kind of finding."""

    default_code = "collision_monitor"


class GuardedMonitor:
    """Collision monitor with checked answers.

    Args:
        settings: Distances, and the monitor as ``module:Class``; it is made with all that follows, settings third.
        model: Kinematics and shapes.
        limits: Of all joints.
        groups: Joints that brake together, one array a group.
        period_s: Servo period [s].

    Raises:
        ConfigError: There is no such module or class, or it cannot be made.
    """

    def __init__(
        self,
        settings: Collision,
        model: CellModel,
        limits: MotionLimits,
        groups: Sequence[NDArray[np.intp]],
        period_s: float,
    ) -> None:
        self._name = settings.monitor
        made = plugins.make(self._name, "collision monitor", model, limits, settings, groups, period_s)
        self._monitor: CollisionMonitor = made  # type: ignore[assignment]  # calls are guarded

    def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and pairs from the next tick on.

        Raises:
            CollisionMonitorError: The monitor cannot, or raised an error.
        """
        try:
            self._monitor.surround(around)
        except FOREIGN as error:  # a monitor of the user's may raise anything, and lack the method
            told = f"collision monitor '{self._name}' takes no free bodies: {type(error).__name__}: {error}"
            raise CollisionMonitorError(told, monitor=self._name) from error

    def update(
        self, q: NDArray[np.float64], v: NDArray[np.float64], a: NDArray[np.float64], curves: Mapping[int, Ahead]
    ) -> Proximity:
        """Look at one tick; arguments as of :meth:`CollisionMonitor.update`.

        Raises:
            CollisionMonitorError: The monitor raised an error, or returned no speed ceiling from 0 to 1.
            DataError: A value is not a finite number.
        """
        try:
            near = self._monitor.update(q, v, a, curves)
            if not (0.0 <= near.speed_ceiling <= 1.0 and not math.isnan(near.distance)):
                raise ValueError(f"it returned {near}")
        except ImError:
            raise
        except FOREIGN as error:  # a monitor of the user's may raise anything
            told = f"collision monitor '{self._name}': {type(error).__name__}: {error}"
            raise CollisionMonitorError(told, monitor=self._name) from error
        return near
