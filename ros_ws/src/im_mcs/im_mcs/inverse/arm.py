"""Singularities and reach of an arm of five or six joints: by name where it is a PUMA 560's, else by its Jacobian."""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import StateError
from im_mcs.model import CellModel

ARM_JOINTS = 6
FEWEST_JOINTS = 5
# places at which the factors are compared with the determinant [rad], and how well they agree
_PLACES = 0.3 + 0.7 * np.outer(np.arange(1.0, 5.0), [1.0, 0.7, -0.6, 0.9, -0.8, 0.5])
_AGREE = 1e-6


class Arm:
    """Last six joints before a frame; of a chain of five, these.

    Where these are two intersecting axes, an elbow parallel to the second, and a spherical wrist, the determinant of
    the Jacobian is the product of three factors (R.P. Paul, C.N. Stevenson, "Kinematics of robot wrists", 1983): how
    far the wrist's centre is from the first axis (shoulder), how far the elbow is bent, and the sine of joint 5
    (wrist). Each factor is 0 in the singularity of that name. Whether an arm is built so is found by comparing both.
    Of any other arm the one factor is the determinant, and nothing is known of its reach but the lengths of its links.

    An arm of five joints gives up turns about one axis of the frame: the one about which it cannot turn the frame in
    its place. The axis counts as a sixth joint, and all else is as of six joints.

    Attributes:
        singularities: Names of the factors.
        joints: Ranks of the joints among all, shape (6,) or (5,).
        given_up: The axis of the frame for turns that are given up, shape (3, 1); of six joints none, shape (3, 0).
        carriers: Ranks of the joints that carry the arm, in order.
        reach: From the second axis to the centre of the wrist with the arm stretched out; of an arm of another build to
            the frame, no less than that [m].
    """

    def __init__(self, model: CellModel, frame: str) -> None:
        self._model = model
        chain = [int(model.pin.frames[model.frame_id(frame)].parentJoint)]
        while chain[-1] != 0:
            chain.append(int(model.pin.parents[chain[-1]]))
        ranks = np.array(chain[-2::-1], dtype=np.intp) - 1
        if len(ranks) < FEWEST_JOINTS:
            text = f"{frame} hangs on {len(ranks)} joints; an arm of {FEWEST_JOINTS} or more is needed"
            raise StateError(text, frame=frame)
        self.joints, self.carriers = ranks[-ARM_JOINTS:], ranks[:-ARM_JOINTS]
        placements = [model.pin.jointPlacements[int(rank) + 1] for rank in self.joints]
        shoulder, elbow, forearm, wrist = placements[1:5]
        centre = forearm.act(wrist.translation)  # of the wrist, in the frame of joint 3
        self._upper = float(np.hypot(*elbow.translation[:2]))
        self._fore = float(np.hypot(*centre[:2]))
        self._bend = math.atan2(centre[1], centre[0]) - math.atan2(elbow.translation[1], elbow.translation[0])
        self._offset = float(centre[2] + elbow.translation[2])
        self._upright = shoulder.rotation.T[:2, 2]  # the first axis, in the plane of the upper arm
        self._shoulder = shoulder.translation
        self._data = model.pin.createData()
        self.reach = self._upper + self._fore
        self._frame = model.frame_id(frame)
        self.singularities: tuple[str, ...] = ("shoulder", "elbow", "wrist")
        self.given_up: NDArray[np.float64] = np.zeros((3, 0))
        if len(self.joints) < ARM_JOINTS or not self._has_wrist():
            self.singularities = ("arm",)
            last = model.pin.frames[self._frame].placement
            self.reach = float(sum(np.linalg.norm(place.translation) for place in (*placements[2:], last)))
        self.give_up(model.cell.home)

    def give_up(self, q_all: NDArray[np.float64]) -> None:
        """Choose the axis to give up at ``q_all``, shape (n,): across all turns of the frame in its place."""
        if len(self.joints) == ARM_JOINTS:
            return
        jacobian = self._jacobian(q_all)
        in_place = np.linalg.svd(jacobian[:3])[2][3:].T
        self.given_up = np.linalg.svd(jacobian[3:] @ in_place)[0][:, 2:]

    def square(self, jacobian: NDArray[np.float64], turn: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the columns of the arm, with one of the axis that is given up, shape (6, 6).

        Args:
            jacobian: Of all joints, shape (6, n): linear, angular.
            turn: Rotation from the frame to the axes of the Jacobian, shape (3, 3).
        """
        return np.hstack([jacobian[:, self.joints], _column(turn @ self.given_up)])

    def factors(self, q: NDArray[np.float64]) -> tuple[float, ...]:
        """Shoulder, elbow and wrist factor, each signed and at most 1 in size; or the determinant alone.

        Args:
            q: Positions of the arm's joints [rad].
        """
        if len(self.singularities) == 1:
            return (self._determinant(q),)
        x, y = self._centre(q)
        off_axis = x * self._upright[1] - y * self._upright[0]
        return off_axis / self.reach, math.sin(q[2] + self._bend), math.sin(q[4])

    def away(self, q: NDArray[np.float64], wanted: float) -> NDArray[np.float64]:
        """Return the direction of growing factors up to ``wanted``, shape (6,); 0 for larger ones, or none known.

        Args:
            q: Positions of the arm's joints, shape (6,) [rad].
            wanted: Size that each factor should have.
        """
        gradient = np.zeros(ARM_JOINTS)
        if len(self.singularities) == 1:
            return gradient
        shoulder, elbow, wrist = self.factors(q)
        x, y = self._centre(q)
        forearm = q[1] + q[2] + self._bend
        fore_x, fore_y = self._fore * math.cos(forearm), self._fore * math.sin(forearm)
        up_x, up_y = self._upright
        lack = _lack(shoulder, wanted) / self.reach
        gradient[1] += lack * (-y * up_y - x * up_x)
        gradient[2] += lack * (-fore_y * up_y - fore_x * up_x)
        gradient[2] += _lack(elbow, wanted) * math.cos(q[2] + self._bend)
        gradient[4] += _lack(wrist, wanted) * math.cos(q[4])
        return gradient

    def beyond_reach(self, q_all: NDArray[np.float64], wrist: NDArray[np.float64]) -> float:
        """Return the distance of a place from the arm's reach, 0 if within [m].

        Args:
            q_all: Positions of all joints; only those of the carriers matter, shape (n,) [rad or m].
            wrist: Where the centre of the wrist shall be in ``world``, shape (3,) [m].
        """
        pin.forwardKinematics(self._model.pin, self._data, q_all)
        base = self._data.oMi[int(self.joints[0]) + 1]
        to = base.rotation.T @ (wrist - base.translation) - self._shoulder
        if len(self.singularities) == 1:
            return max(float(np.linalg.norm(to)) - self.reach, 0.0)
        off_axis = math.hypot(to[0], to[1])
        in_plane = math.sqrt(max(float(to @ to) - self._offset**2, 0.0))
        nearest = abs(self._upper - self._fore)
        return max(in_plane - self.reach, nearest - in_plane, abs(self._offset) - off_axis, 0.0)

    def _determinant(self, q: NDArray[np.float64]) -> float:
        """Determinant of the arm's Jacobian, lengths divided by the reach."""
        whole = np.zeros(self._model.n)
        whole[self.joints] = q
        return float(np.linalg.det(np.hstack([self._jacobian(whole), _column(self.given_up)]))) / self.reach**3

    def _jacobian(self, q_all: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns of the arm's joints along the axes of the frame, shape (6, 6) or (6, 5)."""
        frame = pin.ReferenceFrame.LOCAL
        return np.asarray(
            pin.computeFrameJacobian(self._model.pin, self._data, q_all, self._frame, frame)[:, self.joints]
        )

    def _has_wrist(self) -> bool:
        """Whether the determinant is the product of the three factors."""
        ratios = [self._determinant(q) / math.prod(self.factors(q)) for q in _PLACES]
        return max(ratios) - min(ratios) <= _AGREE * max(map(abs, ratios))

    def _centre(self, q: NDArray[np.float64]) -> tuple[float, float]:
        """Centre of the wrist in the plane of the upper arm, from the second axis [m]."""
        forearm = q[1] + q[2] + self._bend
        x = self._upper * math.cos(q[1]) + self._fore * math.cos(forearm)
        return x, self._upper * math.sin(q[1]) + self._fore * math.sin(forearm)


def _lack(factor: float, wanted: float) -> float:
    """Return the missing part of a factor, with the sign; at 0 the positive side is chosen."""
    return math.copysign(max(wanted - abs(factor), 0.0), factor)


def _column(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return twists about axes through the origin, shape (6, n)."""
    return np.vstack([np.zeros_like(axes), axes])
