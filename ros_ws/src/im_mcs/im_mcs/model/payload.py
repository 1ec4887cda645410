"""Payload of an arm: checked, and taken into the controllers' model without a bump."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_core.errors import DataError, LimitError, NotFoundError
from im_mcs.model.dynamics import CellModel

_MOMENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Payload:
    """A rigid body held by a wrist.

    Attributes:
        mass: [kg]; 0: nothing is held.
        center: Centre of mass in the wrist frame, shape (3,) [m].
        inertia: About the centre of mass, along the axes of the wrist frame: xx, xy, xz, yy, yz, zz [kg m2]; all
            zeros: a point mass.
    """

    mass: float
    center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    inertia: tuple[float, float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

    @classmethod
    def checked(
        cls, mass: float, center: Sequence[float], inertia: Sequence[float], rated_kg: float, reach_m: float
    ) -> "Payload":
        """Return a payload, if possible for a rigid body and allowed for the arm.

        Args:
            mass: [kg].
            center: Shape (3,) [m].
            inertia: Shape (6,) [kg m2].
            rated_kg: Largest mass [kg].
            reach_m: Largest distance of the centre, and of the mass from it, per axis [m].

        Raises:
            DataError: A size is wrong, a number is not finite, or no rigid body has such an inertia.
            LimitError: It is too heavy or too far out.
        """
        for what, values, size in (("mass", [mass], 1), ("center", center, 3), ("inertia", inertia, 6)):
            if len(values) != size or not all(math.isfinite(value) for value in values):
                raise DataError(f"payload: {what} is {list(values)}, not {size} finite number{'s' * (size > 1)}")
        if mass < 0.0:
            raise LimitError(joint="payload", value=mass, limit=0.0, unit="kg", what="mass")
        if mass > rated_kg:
            raise LimitError(joint="payload", value=mass, limit=rated_kg, unit="kg", what="mass")
        for axis, value in zip("xyz", center, strict=True):
            if abs(value) > reach_m:
                limit = math.copysign(reach_m, value)
                raise LimitError(joint="payload", value=value, limit=limit, unit="m", what=f"center.{axis}")
        (x, y, z), (xx, xy, xz, yy, yz, zz) = center, inertia
        payload = cls(mass, (x, y, z), (xx, xy, xz, yy, yz, zz))
        _check_inertia(payload, reach_m)
        return payload

    @property
    def moments(self) -> NDArray[np.float64]:
        """Inertia about the centre of mass, shape (3, 3) [kg m2]."""
        xx, xy, xz, yy, yz, zz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _check_inertia(payload: Payload, reach_m: float) -> None:
    if not any(payload.inertia):
        return
    given = ", ".join(f"{name} {value:g}" for name, value in zip(_MOMENTS, payload.inertia, strict=True))
    if payload.mass == 0.0:
        raise DataError(f"payload: without mass there is no inertia; it is {given}")
    least, middle, largest = np.linalg.eigvalsh(payload.moments)
    if not least > 0.0:
        raise DataError(f"payload: the inertia ({given}) is not positive definite: a principal moment is {least:.3g}")
    if least + middle < largest * (1.0 - _ROUNDING):
        raise DataError(
            f"payload: the inertia ({given}) violates the triangle inequality: the principal moments {least:.3g} and "
            f"{middle:.3g} sum up to less than {largest:.3g}"
        )
    bound = 2.0 * payload.mass * reach_m**2
    if largest > bound:
        raise LimitError(joint="payload", value=float(largest), limit=bound, unit="kg m2", what="principal moment")


class ControlledModel(CellModel):
    """Dynamics for the control laws: possibly wrong by intent, and with the arms' payloads.

    A new payload enters along half a cosine, tick by tick (:meth:`advance`): mass, first moment and inertia about the
    wrist, in which all torques are linear, go from what they are to what they shall be, so that what is carried is a
    rigid body all the way.

    Args:
        cell: Parameters.
        error: Share by which masses and inertias of the arm, those of the rotors too, are made wrong.
    """

    def __init__(self, cell: Cell, error: float = 0.0) -> None:
        super().__init__(cell, error)
        self.wrists = tuple(group.tip for group in cell.groups.values())
        frames = [self.pin.frames[self.frame_id(wrist)] for wrist in self.wrists]
        self._placements = [frame.placement.copy() for frame in frames]
        self._links = [int(frame.parentJoint) for frame in frames]
        self._bare = [self.pin.inertias[link].toDynamicParameters() for link in self._links]
        self._present = np.zeros((len(self.wrists), 10))
        self._from, self._to = self._present, self._present
        self._ticks = self._passed = 0

    @property
    def changing(self) -> bool:
        """Whether a payload is still on the way into the model."""
        return self._passed < self._ticks

    @property
    def carried(self) -> NDArray[np.float64]:
        """Present payloads, for :meth:`carry`, shape (wrists, 10): parameters in the frames of the last links."""
        return self._present

    def set_payload(self, wrist: str, payload: Payload, ticks: int) -> None:
        """Change the payload of a wrist, from the next :meth:`advance` on, completely after ``ticks`` calls.

        Raises:
            NotFoundError: There is no such wrist.
        """
        if wrist not in self.wrists:
            raise NotFoundError(kind="wrist", name=wrist, known=self.wrists)
        side = self.wrists.index(wrist)
        body = pin.Inertia(payload.mass, np.array(payload.center), payload.moments)
        self._from, self._to = self._present, self._to.copy()
        self._to[side] = self._placements[side].act(body).toDynamicParameters() if payload.mass > 0.0 else 0.0
        self._ticks, self._passed = max(1, ticks), 0

    def advance(self) -> None:
        """Do one tick of :meth:`set_payload`'s change; to be called once before the torques of every tick."""
        if self.changing:
            self._passed += 1
            share = 0.5 * (1.0 - math.cos(math.pi * self._passed / self._ticks))
            self.carry((1.0 - share) * self._from + share * self._to if self.changing else self._to)

    def carry(self, parameters: NDArray[np.float64]) -> None:
        """Set the payloads of another model at once, shape (wrists, 10); no fade."""
        self._present = parameters
        for link, bare, more in zip(self._links, self._bare, parameters, strict=True):
            self.pin.inertias[link] = pin.Inertia.FromDynamicParameters(bare + more)
