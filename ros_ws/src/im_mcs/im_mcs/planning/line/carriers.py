"""Places of the carriers of an arm along a line of the wrist, chosen for the arm."""

from collections.abc import Generator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_mcs.inverse import Arm, ArmTracker, IkAttempt, InverseKinematics
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning.line.geometry import SAME_M, LinePath, Via, parameter_length

_PLACES = 8
_ITERATIONS_A_STEP = 4
_SHARES = (0.5, 1.0)
# Distance from a limit, and singular value, from which on an arm is comfortable.
_MARGIN = 0.3
_SINGULAR_VALUE = 0.12
# Share of both with which the arm can do without the carriers.
_ENOUGH = 0.2
# What a second that the carriers need for their way costs.
_EFFORT = 0.05
# Any line that is passed to its end is better than one that is not.
_FAILURE = 100.0


class CarrierChoice:
    """Choice of the carriers' places at the end of a line; on the way the carriers keep step with the wrist.

    They stay where the arm alone keeps off joint limits and singularities: what moves less meets less. Otherwise some
    ends are tried, always the same ones: following the line halfway and wholly with a linear axis, and what inverse
    kinematics of the whole group would take. That one wins whose arm stays farthest from limits and singularities,
    less an effort for the carriers' way.

    Args:
        model: Kinematics.
        limits: Of all joints.
        index: Joints of the group, shape (n,).
        arm: The arm.
        tracker: Its inverse kinematics.
        frame: Its wrist.
        lever: Way that a rotation of one radian counts as [m].
    """

    def __init__(
        self,
        model: CellModel,
        limits: JointLimits,
        index: NDArray[np.intp],
        arm: Arm,
        tracker: ArmTracker,
        frame: str,
        lever: float,
    ) -> None:
        self._model, self._limits, self._index = model, limits, index
        self._arm, self._tracker, self._frame, self._lever = arm, tracker, frame, lever
        self._moved = np.isin(arm.carriers, index)

    def choose(
        self, q_all: NDArray[np.float64], target: pin.SE3, via: Via
    ) -> Generator[None, None, NDArray[np.float64]]:
        """Positions of all joints at the end of a line, a bounded piece of work a step.

        The arm's joints in it are where the arm gets to, if it gets to the end of the line at all.

        Args:
            q_all: Positions of all joints at the beginning of the line, shape (n,) [rad or m].
            target: Pose of the wrist at its end.
            via: Place on the arc to it.
        """
        if not self._moved.any() or parameter_length(self._tracker.pose(q_all), target, self._lever, via) < SAME_M:
            return q_all
        best, chosen = yield from self._trial(q_all, target, via, q_all[self._arm.carriers])
        if best >= _ENOUGH:
            return chosen
        ends = self._followed(q_all, target)
        whole = yield from self._whole_group(q_all, target)
        if whole is not None:
            ends.append(whole[self._arm.carriers])
        for end in ends:
            score, reached = yield from self._trial(q_all, target, via, end)
            if score > best:
                best, chosen = score, reached
        return chosen

    def _followed(self, q_all: NDArray[np.float64], target: pin.SE3) -> list[NDArray[np.float64]]:
        carriers = self._arm.carriers
        way = target.translation - self._tracker.pose(q_all).translation
        columns = self._model.jacobian(q_all, self._frame)[:3, carriers]
        ends = []
        for rank, joint in enumerate(carriers):
            if self._moved[rank] and self._limits.units[joint] == "m":
                for share in _SHARES:
                    end = q_all[carriers].copy()
                    wanted = end[rank] + share * float(columns[:, rank] @ way)
                    end[rank] = np.clip(wanted, self._limits.lower[joint], self._limits.upper[joint])
                    ends.append(end)
        return ends

    def _whole_group(
        self, q_all: NDArray[np.float64], target: pin.SE3
    ) -> Generator[None, None, NDArray[np.float64] | None]:
        solver = InverseKinematics(self._model, self._limits, self._index, self._frame)
        attempts: list[IkAttempt] = []
        for attempt in solver.descent(target, q_all, q_all[self._index]):
            attempts.append(attempt)
            if len(attempts) % _ITERATIONS_A_STEP == 0:
                yield
        if not attempts[-1].reached:
            return None
        whole = q_all.copy()
        whole[self._index] = attempts[-1].q
        return whole

    def _trial(
        self, q_all: NDArray[np.float64], target: pin.SE3, via: Via, end: NDArray[np.float64]
    ) -> Generator[None, None, tuple[float, NDArray[np.float64]]]:
        """Score of one end of the carriers, and positions of all joints there."""
        carriers, joints = self._arm.carriers, self._arm.joints
        poses, rows = [self._tracker.pose(q_all), target], np.array([q_all[carriers], end])
        path = LinePath(poses, rows, 0.0, self._lever, [via])
        effort = float((np.abs(end - q_all[carriers]) / self._limits.motion.velocity[carriers]).max())
        q, step, worst = q_all, np.zeros(len(q_all)), 1.0
        for k in range(1, _PLACES + 1):
            place = path.at(path.size * k / _PLACES)
            guess = q + step
            guess[carriers] = place.carriers[0]
            found = self._tracker.solve(place.pose, guess)
            if found is None:
                q = q.copy()
                q[carriers] = end
                return k / _PLACES - _FAILURE, q
            margin = np.minimum(found - self._limits.lower, self._limits.upper - found)[joints].min()
            comfort = min(float(margin) / _MARGIN, self._tracker.singular_value(found) / _SINGULAR_VALUE)
            worst, step, q = min(worst, comfort), found - q, found
            yield
        return worst - _EFFORT * effort, q
