"""Inverse kinematics of a wrist pose: in closed form where the arm has it, else by damped least squares."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import DataError, ImError
from im_mcs.collision import CollisionChecker
from im_mcs.inverse.arm import ARM_JOINTS, FEWEST_JOINTS, Arm, stretched
from im_mcs.inverse.closed_form import ClosedForm
from im_mcs.inverse.redundancy import Redundancy
from im_mcs.inverse.tracking import ArmTracker
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

# the last ones are all but undamped: near a singularity damped steps end beside the pose
_ITERATIONS, _UNDAMPED = 100, 80
#: Solutions keep clear of the limits, so that a measured position is never beyond them [rad or m].
LIMIT_MARGIN = 0.02
# Where nothing is reached, steps end a little before the limit that is in the way [rad or m].
_AT_LIMIT = 0.01
_POSITION_TOLERANCE_M = 1e-7
_ROTATION_TOLERANCE_RAD = 1e-7
_DAMPING, _LAST_DAMPING = 1e-3, 1e-6
_STEP = 0.5
_NULL_GAIN = 0.1
_NULL_ITERATIONS = 40
# The largest turn about axes that an arm of few joints gives up: what is asked for is then met in all but name.
_GIVEN_UP_RAD = 0.0175
_SEEDS = 32
# Starts after the first ones end where so many steps have not brought the error below that share.
_STALLED, _SHARE = 20, 0.5
_NEAREST, _FAR = 2, 8
_SEED_KEY = 20240607


@dataclass(frozen=True)
class IkAttempt:
    """Where an iteration ended.

    Attributes:
        q: Positions of the group, shape (n,) [rad or m].
        position_error: Distance from the wanted position [m].
        rotation_error: Angle from the wanted orientation [rad].
    """

    q: NDArray[np.float64]
    position_error: float
    rotation_error: float

    @property
    def reached(self) -> bool:
        """Whether the pose is met."""
        return self.position_error < _POSITION_TOLERANCE_M and self.rotation_error < _ROTATION_TOLERANCE_RAD


class InverseKinematics:
    """Joint positions of one group for a pose of the wrist.

    Six joints of a build that :class:`ClosedForm` knows have all their solutions at once, the nearest to the start
    first. Of all others each step solves ``dq = J^T (J J^T + d^2 I)^-1 e`` (Y. Nakamura, H. Hanafusa, 1986) over the
    joints that are not against a limit; what remains of the redundancy goes where :class:`Redundancy` wishes: off
    limits and singularities, carts near their nominal place. Several starts are tried, always the same ones in the same
    order.

    Fewer joints meet the place of a pose, and its orientation but for a turn of at most a degree about the axes that
    they give up (:class:`Arm`): of a pose written in decimals, for instance.

    Args:
        model: Kinematics.
        limits: Ranges of the joints.
        index: Joints of the group, shape (n,).
        frame: Its wrist frame.
    """

    def __init__(self, model: CellModel, limits: JointLimits, index: NDArray[np.intp], frame: str) -> None:
        self._model = model
        self._limits = limits
        self._index = index
        self._frame = frame
        self._lower = limits.lower[index] + LIMIT_MARGIN
        self._upper = limits.upper[index] - LIMIT_MARGIN
        self._preferred = np.clip(model.cell.home[index], self._lower, self._upper)
        self._redundancy = Redundancy(model, limits, index, frame, self._preferred)
        self._closed: ClosedForm | None = None
        self._short: Arm | None = None
        below = model.joints_below(frame)
        chain = below[np.maximum.accumulate(np.isin(below, index))]
        self._first, self._reach = model.names[chain[0]] if len(chain) else frame, stretched(model, chain, frame)
        if len(index) >= FEWEST_JOINTS and set(model.joints_below(frame)[-ARM_JOINTS:].tolist()) == set(index.tolist()):
            arm = Arm(model, frame)
            self._joints, self._tracker = arm.joints, ArmTracker(model, arm, frame)
            self._closed = ClosedForm.of(model, frame, arm.joints)
            self._short = arm if len(arm.joints) < ARM_JOINTS else None

    def solve(
        self,
        target: pin.SE3,
        q_all: NDArray[np.float64],
        seed: NDArray[np.float64],
        collision: CollisionChecker | None = None,
    ) -> NDArray[np.float64]:
        """Find joint positions.

        Args:
            target: Wanted pose of the wrist in ``world``.
            q_all: Positions of all joints; those of other groups stay, shape (n,) [rad or m].
            seed: Where to start, shape (n,) [rad or m].
            collision: If given, solutions in collision are passed over; only pairs that the group moves count.

        Returns:
            Positions of the group, shape (n,) [rad or m].

        Raises:
            DataError: The pose is out of reach (code ``unreachable``); the message says where the nearest solution is.
            ImError: It is within reach, but only in collision (code ``collision``).
        """
        best: IkAttempt | None = None
        blocked: ImError | None = None
        moved = None if collision is None else collision.moved(self._index)
        for attempt in self.attempts(target, q_all, self._starts(seed)):
            if attempt.reached:
                try:
                    if collision is not None:
                        collision.require_free(self._whole(q_all, attempt.q), among=moved)
                except ImError as error:
                    blocked = blocked or error
                    continue
                return attempt.q
            best = min(best or attempt, attempt, key=lambda each: each.position_error)
        if blocked is not None:
            raise blocked
        assert best is not None
        x, y, z = target.translation
        near = self._model.pose(self._whole(q_all, best.q), self._frame).translation
        raise DataError(
            f"{self._frame} at ({x:.3f}, {y:.3f}, {z:.3f}) m is out of reach: the nearest solution is at "
            f"({near[0]:.3f}, {near[1]:.3f}, {near[2]:.3f}) m, "
            f"{best.position_error * 1e3:.1f} mm and {np.degrees(best.rotation_error):.2f} deg off"
            f"{self._at_limits(best.q)}",
            code="unreachable",
            frame=self._frame,
            position_m=[float(x), float(y), float(z)],
            nearest_m=near.tolist(),
        )

    def _at_limits(self, q: NDArray[np.float64]) -> str:
        """Return the joints against a limit, a clause; empty if there is none."""
        limits, told = self._limits, []
        for i, value, lower, upper in zip(self._index, q, self._lower, self._upper, strict=True):
            if min(value - lower, upper - value) < _AT_LIMIT:
                limit = limits.lower[i] if value - lower < upper - value else limits.upper[i]
                told.append(f"{limits.names[i]} {limit:.4g} {limits.units[i]}")
        return f", with joints against their limits: {', '.join(told)}" if told else ""

    def _starts(self, seed: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        generator = np.random.Generator(np.random.Philox(key=_SEED_KEY))
        spread = generator.uniform(size=(_SEEDS - 2, len(seed)))
        return [seed, self._preferred, *(self._lower + spread * (self._upper - self._lower))]

    def attempts(
        self, target: pin.SE3, q_all: NDArray[np.float64], starts: Sequence[NDArray[np.float64]]
    ) -> Iterator[IkAttempt]:
        """Solutions in closed form, the nearest to the first start first; else an attempt from each start.

        Args:
            target: Wanted pose of the wrist in ``world``.
            q_all: Positions of all joints; those of other groups stay, shape (n,) [rad or m].
            starts: Where to start, shape (n,) each [rad or m].
        """
        if self._closed is not None:
            if found := self.solutions(target, q_all, starts[0]):
                yield from found
                return
            starts = starts[:_NEAREST]  # nothing is there to be found but the nearest place
        elif self._is_beyond(target, q_all):
            starts = starts[:_FAR]
        for rank, start in enumerate(starts):
            *way, end = self.descent(target, q_all, start, patient=rank < _NEAREST)
            yield end if end.reached else min(*way, end, key=lambda each: each.position_error)

    def _is_beyond(self, target: pin.SE3, q_all: NDArray[np.float64]) -> bool:
        """Whether a place is farther from the group's first joint than the stretched chain is long."""
        base = self._model.pose(q_all, self._first).translation
        return bool(np.linalg.norm(target.translation - base) > self._reach)

    def solutions(self, target: pin.SE3, q_all: NDArray[np.float64], start: NDArray[np.float64]) -> list[IkAttempt]:
        """Return the solutions within limits, the nearest to a start first, each improved by Newton's method.

        Of an arm without a closed form none is known.

        Args:
            target: Wanted pose of the wrist in ``world``.
            q_all: Positions of all joints; those of other groups stay, shape (n,) [rad or m].
            start: Positions of the group, shape (n,) [rad or m].
        """
        if self._closed is None:
            return []
        at, found, joints = self._whole(q_all, start), list[IkAttempt](), self._joints
        for q in self._closed.solve(self._model, target, at, joints):
            whole = at.copy()
            whole[joints] = q
            better = self._tracker.solve(target, whole)
            near = start + np.remainder((whole if better is None else better)[self._index] - start + np.pi, 2 * np.pi)
            near -= np.pi
            near += 2.0 * np.pi * ((near < self._lower).astype(float) - (near > self._upper))
            attempt = self._attempt(target, q_all, near, self._error(target, q_all, near))
            if attempt.reached and ((near >= self._lower) & (near <= self._upper)).all():
                found.append(attempt)
        return sorted(found, key=lambda each: float(np.linalg.norm(each.q - start)))

    def descent(
        self, target: pin.SE3, q_all: NDArray[np.float64], start: NDArray[np.float64], patient: bool = True
    ) -> Iterator[IkAttempt]:
        """Iterate from one start; the last attempt is the end.

        Args:
            target: Wanted pose of the wrist in ``world``.
            q_all: Positions of all joints; those of other groups stay, shape (n,) [rad or m].
            start: Where to start, shape (n,) [rad or m].
            patient: Whether to go on where the error hardly falls: damping ends late.
        """
        q = np.clip(start, self._lower, self._upper)
        error = self._error(target, q_all, q)
        least = list[float]()
        for k in range(_ITERATIONS):
            yield (attempt := self._attempt(target, q_all, q, error))
            if attempt.reached and k >= _NULL_ITERATIONS:
                return
            least.append(min([float(np.linalg.norm(error)), *least[-1:]]))
            stalled = least[k] < _POSITION_TOLERANCE_M or least[k] > _SHARE * least[max(k - _STALLED, 0)]
            if stalled and k >= _STALLED and not (patient or attempt.reached):
                return
            whole = self._whole(q_all, q)
            rows, jacobian = self._rows(whole), self._model.jacobian(whole, self._frame)[:, self._index]
            pull = _NULL_GAIN * max(0.0, 1.0 - k / _NULL_ITERATIONS)  # ends, so that the last steps converge
            damping = _DAMPING if k < _UNDAMPED else _LAST_DAMPING
            q = self._step(rows @ jacobian, rows @ error, q, pull, damping)
            error = self._error(target, q_all, q)

    def _step(
        self,
        jacobian: NDArray[np.float64],
        error: NDArray[np.float64],
        q: NDArray[np.float64],
        pull: float,
        damping: float,
    ) -> NDArray[np.float64]:
        """One damped step within the limits."""
        free = np.ones(len(q), dtype=np.bool_)
        wish = pull * self._redundancy.wish(q) if pull > 0.0 else np.zeros(len(q))
        for _ in range(2):
            j = jacobian * free
            inverse = j.T @ np.linalg.inv(j @ j.T + damping**2 * np.eye(len(j)))
            step = inverse @ error
            step += (wish - inverse @ (j @ wish)) * free
            step *= min(1.0, _STEP / max(float(np.abs(step).max()), 1e-12))
            outside = ((q + step) < self._lower) | ((q + step) > self._upper)
            if not (outside & free).any():
                break
            free &= ~outside
        return np.clip(q + step, self._lower, self._upper)

    def _attempt(
        self, target: pin.SE3, q_all: NDArray[np.float64], q: NDArray[np.float64], error: NDArray[np.float64]
    ) -> IkAttempt:
        angle = float(np.linalg.norm(error[3:]))
        if self._short is not None:
            pose = self._model.pose(self._whole(q_all, q), self._frame)
            turn = float(np.linalg.norm(pin.log3(target.rotation @ pose.rotation.T)))
            angle = angle if turn < _GIVEN_UP_RAD else turn
        return IkAttempt(q, float(np.linalg.norm(error[:3])), angle)

    def _error(self, target: pin.SE3, q_all: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = self._whole(q_all, q)
        if self._short is not None:
            self._short.give_up(whole)
            return self._tracker.error(target, whole)
        pose = self._model.pose(whole, self._frame)
        rotation = pin.log3(target.rotation @ pose.rotation.T)
        return np.concatenate([target.translation - pose.translation, rotation])

    def _rows(self, whole: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the map from twists to the parts kept by the arm, shape (6, 6), or (n, 6) of n joints."""
        if self._short is None:
            return np.eye(6)
        return self._short.rows(self._model.pose(whole, self._frame).rotation @ self._short.kept)

    def _whole(self, q_all: NDArray[np.float64], q: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = q_all.copy()
        whole[self._index] = q
        return whole
