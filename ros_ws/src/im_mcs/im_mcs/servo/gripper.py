"""Grippers: told where to go and how hard to press, done when the jaws stand still."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, LimitError, LinkError, NotFoundError, StateError
from im_mcs.protocol.requests import SetGripperRequest
from im_mcs.servo.answers import Answers
from im_mcs.testbed import Measured

_STILL_M = 1e-5
_STILL_TICKS = 5
_REACHED_M = 1e-3


@dataclass
class GripperMotion:
    """Moving jaws, until at a standstill: at the wanted opening, or against an object.

    Those whose reading is not steady, or that give none, stand when they have come no further for a long while.

    Attributes:
        id: Request that asked for it.
        slot: Which gripper.
        last: Opening of the last tick [m].
        place: Opening to which they have come [m].
        still: For how many ticks the jaws have stood.
        stayed: For how many ticks they have come no further than that.
        fault: Why they stop on the way, if they do.
    """

    id: int
    slot: int
    last: float
    place: float
    still: int = 0
    stayed: int = 0
    fault: ImError | None = None

    def update(self, openings: NDArray[np.float64], patience_ticks: int) -> bool:
        """Take the measured openings, shape (m,) [m]; whether the jaws have come to stand."""
        opening = float(openings[self.slot])
        self.still = self.still + 1 if abs(opening - self.last) < _STILL_M else 0
        self.last = opening
        if math.isfinite(opening) and not abs(opening - self.place) <= _REACHED_M:
            self.place, self.stayed = opening, 0
        else:
            self.stayed += 1
        return self.still >= _STILL_TICKS or self.stayed >= patience_ticks


class Grippers:
    """All grippers.

    Attributes:
        opening: Wanted openings, shape (m,) [m].
        force: Largest forces between the jaws, shape (m,) [N]; infinity: all that the gripper can give.

    Args:
        names: Of the slots.
        stroke: Largest opening [m].
        full_force: Largest force that can be asked for [N].
        measured: Where the jaws are, shape (m,) [m].
        answers: Told when jaws stand still.
        patience_ticks: For how long jaws may come no further before they count as standing, if no reading says so.
    """

    def __init__(
        self,
        names: tuple[str, ...],
        stroke: float,
        full_force: float,
        measured: NDArray[np.float64],
        answers: Answers,
        patience_ticks: int,
    ) -> None:
        self._names = names
        self._stroke, self._full_force = stroke, full_force
        self._answers = answers
        self._patience_ticks = patience_ticks
        self._moving: dict[int, GripperMotion] = {}
        self.hold(measured)

    @property
    def moving(self) -> bool:
        """Whether jaws are moving."""
        return bool(self._moving)

    def hold(self, measured: NDArray[np.float64]) -> None:
        """Stay where the jaws are, shape (m,) [m]."""
        self.opening = measured.copy()
        self.force = np.full(len(self._names), np.inf)

    def find(self, before: NDArray[np.float64], measured: NDArray[np.float64]) -> None:
        """Take up lost jaws again; moved ones stay at the present place, shapes (m,) [m]."""
        elsewhere = np.abs(measured - before) > _REACHED_M
        self.opening = np.where(elsewhere, measured, self.opening)
        self.force = np.where(elsewhere, np.inf, self.force)

    def move(self, number: int, request: SetGripperRequest, measured: NDArray[np.float64]) -> None:
        """Let jaws go to an opening.

        Args:
            number: Of the request; answered at the end.
            request: Which jaws, how wide, how hard.
            measured: Where the jaws are, shape (m,) [m].

        Raises:
            NotFoundError: There is no such gripper.
            LimitError: Opening or force are out of range.
            StateError: The jaws are on their way, and the request does not replace what they do.
        """
        name, opening, force = request.gripper, request.opening, request.force
        if name not in self._names:
            raise NotFoundError(kind="gripper", name=name, known=self._names)
        for value, limit, unit, what in (
            (opening, self._stroke, "m", "opening"),
            (force, self._full_force, "N", "force"),
        ):
            if not 0.0 <= value <= limit:
                raise LimitError(joint=name, value=value, limit=limit if value > 0.0 else 0.0, unit=unit, what=what)
        slot = self._names.index(name)
        if (before := self._moving.get(slot)) is not None:
            if not request.replaces:
                raise StateError(f"{name} is moving; wait for its end", gripper=name)
            replaced = ImError(f"{name}: replaced by goal {number}", code="replaced", gripper=name, goal=number)
            self._answers.reply(before.id, before.fault or replaced)
        self.opening, self.force = self.opening.copy(), self.force.copy()
        self.opening[slot] = opening
        self.force[slot] = force or np.inf
        there = float(measured[slot])
        self._moving[slot] = GripperMotion(number, slot, last=there, place=there)

    def cancel(self, number: int, fault: ImError, measured: NDArray[np.float64]) -> bool:
        """Stop jaws at the present place; the request ends with ``fault`` after the standstill.

        Args:
            number: Of the request that let them move.
            fault: Why.
            measured: Where the jaws are, shape (m,) [m].

        Returns:
            Whether that request is under way.
        """
        motion = next((motion for motion in self._moving.values() if motion.id == number), None)
        if motion is None:
            return False
        self.opening = self.opening.copy()
        self.opening[motion.slot] = measured[motion.slot]
        motion.fault = fault
        return True

    def update(self, m: Measured) -> None:
        """Report jaws at a standstill."""
        if not self._moving:
            return
        for motion in [each for each in self._moving.values() if each.update(m.gripper, self._patience_ticks)]:
            del self._moving[motion.slot]
            if not math.isfinite(motion.last):
                name = self._names[motion.slot]
                silent = LinkError(f"{name} gave no reading of its opening at tick {m.tick}", gripper=name, tick=m.tick)
                self._answers.reply(motion.id, motion.fault or silent)
                continue
            results: dict[str, object] = {
                "opening": motion.last,
                "reached": abs(motion.last - float(self.opening[motion.slot])) <= _REACHED_M,
            }
            if math.isfinite(force := float(m.gripper_force[motion.slot])):
                results["force"] = force
            self._answers.reply(motion.id, motion.fault, results)

    def drop_goals(self, reason: ImError, measured: NDArray[np.float64]) -> None:
        """End every motion with ``reason``, at once."""
        self.hold(measured)
        for motion in self._moving.values():
            self._answers.reply(motion.id, reason)
        self._moving.clear()
