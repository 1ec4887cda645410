"""The panel of a testbed: faults, objects between the jaws, and wrist lights by name."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_cell.link import Faults, JawObject, PanelEnd
from im_cell.robot import Cell
from im_cell.rotations import matrix_of_quaternion
from im_core.errors import DataError, NotFoundError, StateError

LONGEST_STALL_S = 60.0
FARTHEST_M = 3.9  # the floor has edges
_OF_JOINTS = ("encoder_nan", "encoder_frozen", "brake_stuck", "brake_open")
FAULTS = (*_OF_JOINTS, "power_loss", "stall")


class FaultPanel:
    """Panel of faults: breaks and mends a testbed; physics obeys from the next tick on."""

    def __init__(self, cell: Cell, link: PanelEnd) -> None:
        self._joints = cell.joint_names
        self._bodies = cell.objects
        self._grippers = tuple(cell.devices("gripper"))
        self._link = link

    def inject(self, fault: str, joint: str, active: bool, duration: float) -> str:
        """Switch a fault on or off; return the present faults as a sentence.

        Args:
            fault: One of :data:`FAULTS`.
            joint: Whose encoder or brake; empty for faults of the whole testbed.
            active: Whether it is broken.
            duration: Of a stall, wall time [s]; other faults last until they are switched off.

        Raises:
            DataError: A joint or duration is given where there is none, or is out of range.
            NotFoundError: There is no such fault or joint.
        """
        if fault not in FAULTS:
            raise NotFoundError(kind="fault", name=fault, known=FAULTS)
        if fault not in _OF_JOINTS and joint:
            raise DataError(f"{fault} is a fault of the whole testbed, not of '{joint}'", fault=fault, joint=joint)
        if fault == "stall":
            if not active or not 0.0 < duration <= LONGEST_STALL_S:
                raise DataError(
                    f"a stall of {duration} s (active: {active}) is not possible; it must be active, above 0 s and"
                    f" up to {LONGEST_STALL_S:g} s long",
                    duration=duration,
                )
            self._link.stall(duration)
            return f"physics stalls for {duration:g} s"
        faults = self._link.faults()
        if fault == "power_loss":
            faults = replace(faults, power_loss=active)
        else:
            changed: dict[str, Any] = {fault: self._switched(getattr(faults, fault), joint, active)}
            faults = replace(faults, **changed)
        self._link.set_faults(faults)
        return self._sentence(faults)

    def put_in_jaws(self, gripper: str, width: float, stiffness: float, mass: float) -> str:
        """Put an object between the jaws of a gripper, or take one away; return the present objects as a sentence.

        Args:
            gripper: Its name.
            width: [m]; 0: nothing is there any more.
            stiffness: [N/m].
            mass: [kg].

        Raises:
            DataError: Such an object cannot be.
            NotFoundError: There is no such gripper.
            StateError: Its jaws have shape, and hold free bodies.
        """
        if gripper not in self._grippers:
            raise NotFoundError(kind="gripper", name=gripper, known=self._grippers)
        if self._bodies:
            raise StateError("this cell has free bodies: place one between the jaws")
        held = None if width == 0.0 else JawObject(width, stiffness, mass)
        self._link.set_object(self._grippers.index(gripper), held)
        return f"nothing is in {gripper}" if held is None else f"{1e3 * width:g} mm wide, {mass:g} kg, in {gripper}"

    def place(self, name: str, pose: Sequence[float]) -> str:
        """Place a free body, at rest; return a sentence that says so.

        Args:
            name: Of the body.
            pose: Of its middle: position [m] and quaternion x, y, z, w, shape (7,).

        Raises:
            DataError: That is no pose near the cell.
            NotFoundError: There is no such body.
        """
        names = [body.name for body in self._bodies]
        if name not in names:
            raise NotFoundError(kind="object", name=name, known=names)
        if not all(abs(value) <= FARTHEST_M for value in pose[:3]):
            raise DataError(f"{name} cannot be at {tuple(pose[:3])} m; at most {FARTHEST_M:g} m from the origin")
        matrix_of_quaternion(pose[3:])
        self._link.place(names.index(name), np.array(pose))
        return f"{name} is at ({', '.join(f'{value:g}' for value in pose[:3])}) m"

    def bodies(self) -> dict[str, tuple[float, ...]]:
        """Return the true poses of the free bodies: position [m] and quaternion x, y, z, w, by name."""
        poses = self._link.bodies().tolist()
        return {body.name: tuple(pose) for body, pose in zip(self._bodies, poses, strict=False)}

    def _switched(self, before: NDArray[np.bool_], joint: str, active: bool) -> NDArray[np.bool_]:
        if joint not in self._joints:
            raise NotFoundError(kind="joint", name=joint, known=self._joints)
        after = before.copy()
        after[self._joints.index(joint)] = active
        return after

    def _sentence(self, faults: Faults) -> str:
        broken = [
            f"{fault} of {joint}"
            for fault in _OF_JOINTS
            for joint, on in zip(self._joints, getattr(faults, fault), strict=True)
            if on
        ]
        if faults.power_loss:
            broken.append("power_loss")
        return f"broken: {', '.join(broken)}" if broken else "nothing is broken"


class Lights:
    """Switches the lights of a testbed."""

    def __init__(self, link: PanelEnd) -> None:
        self._link = link

    def switch(self, name: str, on: bool) -> None:
        """Switch a light; exposures see the change from the next tick on.

        Raises:
            NotFoundError: There is no light of that name.
        """
        names = self._link.light_names
        if name not in names:
            raise NotFoundError(kind="light", name=name, known=names)
        self._link.set_light(names.index(name), on)

    def state(self) -> dict[str, bool]:
        """Which lights are switched on."""
        return dict(zip(self._link.light_names, self._link.lights(), strict=True))
