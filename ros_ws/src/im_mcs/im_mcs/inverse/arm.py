"""Singularities and reach of an arm of three to six joints: by name where it is a PUMA 560's, else by its Jacobian."""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.errors import StateError
from im_mcs.model import CellModel, jacobian_of

ARM_JOINTS = 6
FEWEST_JOINTS = 3
# places at which the factors are compared with the determinant [rad], and how well they agree
_PLACES = 0.3 + 0.7 * np.outer(np.arange(1.0, 5.0), [1.0, 0.7, -0.6, 0.9, -0.8, 0.5])
_AGREE = 1e-6
_SHORTEST_M = 1e-3


class Arm:
    """Last six joints before a frame; of a shorter chain, all.

    Where these are two intersecting axes, an elbow parallel to the second, and a spherical wrist, the determinant of
    the Jacobian is the product of three factors (R.P. Paul, C.N. Stevenson, "Kinematics of robot wrists", 1983): how
    far the wrist's centre is from the first axis (shoulder), how far the elbow is bent, and the sine of joint 5
    (wrist). Each factor is 0 in the singularity of that name. Whether an arm is built so is found by comparing both.
    Of any other arm the one factor is the determinant, and nothing is known of its reach but the lengths of its links.

    An arm of fewer joints keeps the place of the frame, and as many turns as joints are left: those by which it turns
    the frame in its place. Turns about the other axes are given up: about one axis with five joints, about two with
    four, about all with three.

    Attributes:
        singularities: Names of the factors.
        joints: Ranks of the joints among all, shape (n,), up to six.
        kept: Axes of the frame for turns that are kept, shape (3, n - 3).
        carriers: Ranks of the joints that carry the arm, in order.
        reach: From the second axis to the centre of the wrist with the arm stretched out; of an arm of another build to
            the frame, no less than that [m].
    """

    def __init__(self, model: CellModel, frame: str) -> None:
        self._model = model
        ranks = model.joints_below(frame)
        if len(ranks) < FEWEST_JOINTS:
            text = f"joints that carry {frame}: {len(ranks)}; an arm needs {FEWEST_JOINTS} or more"
            raise StateError(text, frame=frame)
        self.joints, self.carriers = ranks[-ARM_JOINTS:], ranks[:-ARM_JOINTS]
        self._data = model.pin.createData()
        self._frame = model.frame_id(frame)
        self.kept: NDArray[np.float64] = np.eye(3)
        self.give_up(model.cell.home)
        self.singularities: tuple[str, ...] = ("shoulder", "elbow", "wrist")
        if len(self.joints) < ARM_JOINTS or not self._has_wrist():
            self.singularities = ("arm",)
            self.reach = max(stretched(model, self.joints[1:], frame), _SHORTEST_M)
            self._length = stretched(model, self.joints, frame)

    def give_up(self, q_all: NDArray[np.float64]) -> None:
        """Choose the turns to keep at ``q_all``, shape (n,): those of the frame in its place."""
        if len(self.joints) == ARM_JOINTS:
            return
        jacobian, turns = self._jacobian(q_all), len(self.joints) - 3
        in_place = np.linalg.svd(jacobian[:3])[2][3:].T
        self.kept = np.linalg.svd(jacobian[3:] @ in_place)[0][:, :turns] if turns else np.zeros((3, 0))

    def kept_apart(self, apart: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the axes along which the frame turns as a target does, in the frame, shape (3, n - 3).

        One kept turn is the angle about its axis in the rotation from the frame to the target. Its derivative belongs
        to an axis that leans as far as the target is turned away.

        Args:
            apart: Orientation of the target in the frame but for the turns that are kept: half tangents, shape (3,).
        """
        return self.kept + np.cross(apart, self.kept.T).T if self.kept.shape[1] == 1 else self.kept

    def rows(self, axes: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the map from twists to their kept parts, shape (n, 6), for kept axes in the frame of the twists."""
        if len(self.joints) == ARM_JOINTS:
            return np.eye(6)
        rows = np.zeros((len(self.joints), 6))
        rows[:3, :3], rows[3:, 3:] = np.eye(3), axes.T
        return rows

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
        if len(self.singularities) == 1:
            return max(float(np.linalg.norm(wrist - base.translation)) - self._length, 0.0)
        to = base.rotation.T @ (wrist - base.translation) - self._shoulder
        off_axis = math.hypot(to[0], to[1])
        in_plane = math.sqrt(max(float(to @ to) - self._offset**2, 0.0))
        nearest = abs(self._upper - self._fore)
        return max(in_plane - self.reach, nearest - in_plane, abs(self._offset) - off_axis, 0.0)

    def _determinant(self, q: NDArray[np.float64]) -> float:
        """Determinant of the arm's Jacobian, lengths divided by the reach."""
        whole = np.zeros(self._model.n)
        whole[self.joints] = q
        return float(np.linalg.det(self.rows(self.kept) @ self._jacobian(whole))) / self.reach**3

    def _jacobian(self, q_all: NDArray[np.float64]) -> NDArray[np.float64]:
        """Columns of the arm's joints along the axes of the frame, shape (6, n)."""
        return jacobian_of(self._model.pin, self._data, q_all, self._frame, pin.ReferenceFrame.LOCAL)[:, self.joints]

    def _has_wrist(self) -> bool:
        """Whether the determinant is the product of the three factors, but for a constant one."""
        placements = [self._model.pin.jointPlacements[int(rank) + 1] for rank in self.joints]
        shoulder, elbow, forearm, wrist = placements[1:5]
        centre = forearm.act(wrist.translation)  # of the wrist, in the frame of joint 3
        self._upper = float(np.hypot(*elbow.translation[:2]))
        self._fore = float(np.hypot(*centre[:2]))
        self._bend = math.atan2(centre[1], centre[0]) - math.atan2(elbow.translation[1], elbow.translation[0])
        self._offset = float(centre[2] + elbow.translation[2])
        self._upright = shoulder.rotation.T[:2, 2]  # the first axis, in the plane of the upper arm
        self._shoulder = shoulder.translation
        self.reach = self._upper + self._fore
        if self.reach < _SHORTEST_M:
            return False
        determinants = np.array([self._determinant(q) for q in _PLACES])
        products = np.array([math.prod(self.factors(q)) for q in _PLACES])
        if not products.any():
            return False
        others = determinants - products * (determinants @ products) / (products @ products)
        return bool(np.abs(others).max() < _AGREE * np.abs(determinants).max())

    def _centre(self, q: NDArray[np.float64]) -> tuple[float, float]:
        """Centre of the wrist in the plane of the upper arm, from the second axis [m]."""
        forearm = q[1] + q[2] + self._bend
        x = self._upper * math.cos(q[1]) + self._fore * math.cos(forearm)
        return x, self._upper * math.sin(q[1]) + self._fore * math.sin(forearm)


def _lack(factor: float, wanted: float) -> float:
    """Return the missing part of a factor, with the sign; at 0 the positive side is chosen."""
    return math.copysign(max(wanted - abs(factor), 0.0), factor)


def stretched(model: CellModel, chain: NDArray[np.intp], frame: str) -> float:
    """Return a length that the way from the first joint of a chain to a frame never exceeds [m]."""
    joints = [model.cell.joints[joint] for joint in chain]
    strokes = [
        max(abs(joint.limits.lower), abs(joint.limits.upper), joint.limits.upper - joint.limits.lower)
        for joint in joints
        if joint.kind == "prismatic"
    ]
    last = model.pin.frames[model.frame_id(frame)].placement
    places = [*(model.pin.jointPlacements[joint + 1] for joint in chain[1:].tolist()), last]
    return float(sum(np.linalg.norm(place.translation) for place in places) + sum(strokes))
