"""Contact on a guarded move: the change of the force at a wrist since the motion began."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.model import CellModel

CONTACT = "contact"
"""Code of the end of a motion by contact."""


class ContactWatch:
    """Judge of the contact of one motion.

    Forces are compared along the axes of the world, where the weight of what a wrist carries stays the same however
    the wrist turns. What accelerates weighs more: a guarded move is slow.

    Attributes:
        force: Change at the wrist that feels it most, in the present tick [N].

    Args:
        group: Name of the group, for messages.
        sensors: Row of each sensor among the wrenches, by its wrist.
        model: Kinematics.
        bound: Change that is a contact [N].
    """

    def __init__(self, group: str, sensors: Mapping[str, int], model: CellModel, bound: float) -> None:
        self._group, self._sensors, self._model, self._bound = group, sensors, model, bound
        self._first: NDArray[np.float64] | None = None
        self.force = 0.0

    def update(self, tick: int, q: NDArray[np.float64], wrenches: NDArray[np.float64]) -> ImError | None:
        """Return the fault that ends the motion: a contact, or a sensor without a reading.

        Args:
            tick: Number of the tick.
            q: Measured positions of all joints, shape (n,) [rad or m].
            wrenches: Forces and torques of the sensors, shape (sensors, 6) [N, Nm].
        """
        turned = [self._model.pose(q, wrist).rotation for wrist in self._sensors]
        forces = np.array([r @ wrenches[row, :3] for r, row in zip(turned, self._sensors.values(), strict=True)])
        wrists = list(self._sensors)
        if not (felt := np.isfinite(forces).all(axis=1)).all():
            wrist = wrists[int(np.argmin(felt))]
            return ImError(
                f"group '{self._group}': the force sensor of {wrist} gives no reading; the guarded move ends",
                code="sensor",
                group=self._group,
                frame=wrist,
            )
        if self._first is None:
            self._first = forces
        changes = np.linalg.norm(forces - self._first, axis=1)
        rank = int(np.argmax(changes))
        self.force = float(changes[rank])
        if self.force < self._bound:
            return None
        return ImError(
            f"group '{self._group}': contact of {wrists[rank]} with {self.force:.3g} N at tick {tick}",
            code=CONTACT,
            group=self._group,
            frame=wrists[rank],
            value=self.force,
            limit=self._bound,
            unit="N",
        )

    def verdict(self, fault: ImError | None) -> ImError | None:
        """Return the fault of a motion that ends with ``fault``: contact is success, the end of the path is failure."""
        if fault is None:
            return ImError(
                f"group '{self._group}': no contact on the way; the force at the end differs by {self.force:.3g} N, "
                f"{self._bound:g} N were asked for",
                code="no_contact",
                group=self._group,
                value=self.force,
                limit=self._bound,
                unit="N",
            )
        return None if fault.code == CONTACT else fault
