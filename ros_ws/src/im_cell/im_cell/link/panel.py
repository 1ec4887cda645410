"""The end of the testbed link of whoever disturbs it: faults, and objects between the jaws."""

import numpy as np

from im_core.errors import DataError
from im_core.testbed_link.block import LinkBlock
from im_core.testbed_link.values import Faults, JawObject


class DisturbSide:
    """Writes faults and objects; one client at a time. Physics takes them at the next tick."""

    _shared: LinkBlock

    def set_faults(self, faults: Faults) -> None:
        """Replace the faults in force."""
        view = self._shared.view
        of_joints = (faults.encoder_nan, faults.encoder_frozen, faults.brake_stuck, faults.brake_open)
        view["fault_joints"][:] = of_joints
        view["fault_power"][()] = faults.power_loss
        self._changed()

    def faults(self) -> Faults:
        """The faults in force."""
        view = self._shared.view
        nan, frozen, stuck, open_ = view["fault_joints"].copy()
        return Faults(nan, frozen, stuck, open_, bool(view["fault_power"]))

    def stall(self, seconds: float) -> None:
        """Let physics pause before its next tick, wall time [s].

        Raises:
            DataError: Not a positive, finite time.
        """
        if not 0.0 < seconds < np.inf:
            raise DataError(f"a stall of {seconds} s is not between 0 and infinity", seconds=seconds)
        self._shared.view["stall_s"][()] = seconds
        self._changed()

    def set_object(self, gripper: int, held: JawObject | None) -> None:
        """Put an object between the jaws of a gripper, or take it away.

        Raises:
            DataError: There is no such gripper.
        """
        objects = self._shared.view["objects"]
        if not 0 <= gripper < len(objects):
            raise DataError(f"gripper {gripper} is not one of 0 to {len(objects) - 1}", gripper=gripper)
        objects[gripper] = (0.0, 0.0, 0.0) if held is None else (held.width, held.stiffness, held.mass)
        self._changed()

    def objects(self) -> tuple[JawObject | None, ...]:
        """What is between the jaws of each gripper."""
        return tuple(
            JawObject(width, stiffness, mass) if width else None
            for width, stiffness, mass in self._shared.view["objects"].tolist()
        )

    def _changed(self) -> None:
        changes = self._shared.view["disturbances"]
        changes[()] = int(changes) + 1
