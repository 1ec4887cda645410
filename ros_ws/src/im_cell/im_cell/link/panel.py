"""Panel of the testbed: the end of the link to switch lights and faults, and to put objects between the jaws."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from im_cell.link.end import ClockEnd, TimeSlot
from im_cell.link.values import Faults, JawObject
from im_core.errors import DataError


class PanelEnd(ClockEnd):
    """Writes lights, faults and objects, and says which servo there is; one client at a time.

    Physics takes what changes at the next tick.
    """

    slot: ClassVar[TimeSlot] = TimeSlot.TESTBED

    @property
    def servo_pid(self) -> int:
        """Process of the attached servo, 0 if none."""
        return int(self._shared.view["servo_pid"])

    @property
    def servo_losses(self) -> int:
        """How often a servo was declared gone."""
        return int(self._shared.view["servo_losses"])

    def set_light(self, index: int, on: bool) -> None:
        """Switch a light; visible from the next tick on.

        Raises:
            DataError: There is no light of that index.
        """
        if not 0 <= index < len(self.light_names):
            raise DataError(f"light {index} is not one of 0 to {len(self.light_names) - 1}", index=index)
        self._shared.view["lights"][index] = on

    def lights(self) -> tuple[bool, ...]:
        """Which lights are switched on, in the order of ``light_names``."""
        return self._shared.lights()

    def set_faults(self, faults: Faults) -> None:
        """Replace the faults in force."""
        view = self._shared.view
        of_joints = (faults.encoder_nan, faults.encoder_frozen, faults.brake_stuck, faults.brake_open)
        with self._changing():
            view["fault_joints"][:] = of_joints
            view["fault_power"][()] = faults.power_loss

    def faults(self) -> Faults:
        """The faults in force."""
        return self._shared.faults()

    def stall(self, seconds: float) -> None:
        """Pause physics before the next tick, wall time [s].

        Raises:
            DataError: Not a positive, finite time.
        """
        if not 0.0 < seconds < np.inf:
            raise DataError(f"a stall of {seconds} s is not between 0 and infinity", seconds=seconds)
        with self._changing():
            self._shared.view["stall_s"][()] = seconds

    def set_object(self, gripper: int, held: JawObject | None) -> None:
        """Put an object between the jaws of a gripper, or remove the object.

        Raises:
            DataError: There is no such gripper.
        """
        objects = self._shared.view["objects"]
        if not 0 <= gripper < len(objects):
            raise DataError(f"gripper {gripper} is not one of 0 to {len(objects) - 1}", gripper=gripper)
        with self._changing():
            objects[gripper] = (0.0, 0.0, 0.0) if held is None else (held.width, held.stiffness, held.mass)

    def objects(self) -> tuple[JawObject | None, ...]:
        """Return the objects between the jaws of each gripper."""
        return self._shared.objects()

    def place(self, body: int, pose: NDArray[np.float64]) -> None:
        """Place a free body, at rest: rank in the cell, position [m] and quaternion x, y, z, w, shape (7,).

        Raises:
            DataError: There is no body of that rank.
        """
        view = self._shared.view
        if not 0 <= body < len(view["placements"]):
            raise DataError(f"body {body} is not one of 0 to {len(view['placements']) - 1}", body=body)
        with self._changing():
            view["placed"][body] = pose
            view["placements"][body] += 1

    def bodies(self) -> NDArray[np.float64]:
        """Return the poses of the free bodies, bodies of the cell first, shape (m, 7) [m, -]."""
        return self._shared.view["bodies"].copy()

    @contextmanager
    def _changing(self) -> Iterator[None]:
        """Block readers in physics until all is written; a node killed during a write may have left the count odd."""
        changes = self._shared.view["disturbances"]
        changes[()] = int(changes) | 1
        yield
        changes[()] = int(changes) + 1
