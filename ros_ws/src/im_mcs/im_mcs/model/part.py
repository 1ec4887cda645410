"""The part of the cell moved by a group: the pose, gravity torques and inertia while all else stands still."""

import json
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_core.errors import DataError, LimitError, NotFoundError
from im_mcs.limits.configuration import McsConfig
from im_mcs.model.dynamics import CellModel

_LARGEST = 1e6


@dataclass(frozen=True)
class Part:
    """Some joints, and the frames of the kinematics."""

    name: str
    joints: tuple[str, ...]
    base: str
    wrists: tuple[str, ...]


def part_of(name: str, config: McsConfig, cell: Cell, preset: str | None = None) -> Part:
    """Return a part by name: the arm of a group, without its carriers, or a group of a preset, in the world then.

    Args:
        name: Name of the part.
        config: Presets.
        cell: Groups, whose arms are named ``<group>_arm``.
        preset: Where a group is looked for; None: in the one in force, then in the others.

    Raises:
        NotFoundError: There is no such part or preset.
    """
    presets = config.presets if preset is None else config.with_preset(preset).presets
    order = [preset] if preset else [config.preset, *(p for p in presets if p != config.preset)]
    arms = {f"{group}_arm": group for group in cell.groups}
    if name in arms:
        group = cell.groups[arms[name]]
        return Part(name, cell.arm_of(arms[name]), group.base, (group.tip,))
    found = next((presets[p][name] for p in order if name in presets[p]), None)
    if found is None:
        known = set(arms).union(*(presets[p] for p in order))
        raise NotFoundError(kind="group", name=name, known=known)
    wrists = found.frames or tuple(
        each.tip for group, each in cell.groups.items() if set(cell.joints_of(group)) & set(found.joints)
    )
    return Part(name, found.joints, "world", wrists)


def parse_positions(text: str, part: Part) -> NDArray[np.float64]:
    """Positions of a part's joints from a JSON list, shape (n,) [rad or m].

    Raises:
        DataError: It is no list of numbers, has the wrong size, or a number is not finite.
    """
    try:
        values = json.loads(text)
    except (ValueError, RecursionError):
        values = None
    if not isinstance(values, list) or any(isinstance(v, bool) or not isinstance(v, int | float) for v in values):
        raise DataError(f"q is '{_short(text)}', not a list of numbers such as [0, 0.785, 3.14, 0, 0.785, 0]")
    if len(values) != len(part.joints):
        raise DataError(
            f"q has {len(values)} numbers; {part.name} has {len(part.joints)} joints: {', '.join(part.joints)}",
            given=len(values),
            needed=len(part.joints),
        )
    for joint, value in zip(part.joints, values, strict=True):
        if not -_LARGEST <= value <= _LARGEST:
            raise DataError(f"q: {joint}: position {_short(str(value))} is not a finite number of sensible size")
    return np.array(values, dtype=np.float64)


def _short(text: str, length: int = 60) -> str:
    return text if len(text) <= length else text[: length - 3] + "..."


class PartModel:
    """Kinematics and dynamics of a part; other joints stand at home, the brakes on, carriers upright."""

    def __init__(self, part: Part, cell: Cell) -> None:
        self.part = part
        self._model = CellModel(cell)
        self.index = np.array([self._model.index(joint) for joint in part.joints], dtype=np.intp)
        self.home = cell.home[self.index]
        self.units = tuple("m" if cell.joints[i].kind == "prismatic" else "rad" for i in self.index)

    def warnings(self, q: Sequence[float]) -> list[str]:
        """Return a sentence for each joint beyond the end stops at ``q``, shape (n,)."""
        sentences = []
        for i, value, unit in zip(self.index, q, self.units, strict=True):
            joint = self._model.cell.joints[i]
            for limit, beyond in (
                (joint.limits.lower, value < joint.limits.lower),
                (joint.limits.upper, value > joint.limits.upper),
            ):
                if beyond:
                    sentences.append(LimitError(joint=joint.name, value=float(value), limit=limit, unit=unit).message)
        return sentences

    def poses(self, q: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
        """Pose of each wrist in the base, shape (4, 4) each, at ``q``, shape (n,)."""
        whole = self._whole(q)
        base = self._model.pose(whole, self.part.base)
        return {
            wrist: np.asarray(base.actInv(self._model.pose(whole, wrist)).homogeneous) for wrist in self.part.wrists
        }

    def gravity(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return torques for a still part at ``q``, shape (n,) [Nm or N]."""
        return np.asarray(self._model.gravity(self._whole(q))[self.index])

    def inertia(self, q: NDArray[np.float64], motors: bool) -> NDArray[np.float64]:
        """Joint-space inertia at ``q``, shape (n, n) [kg m2, kg m or kg].

        Args:
            q: Positions, shape (n,).
            motors: With the rotors' inertia, reflected through the gears.
        """
        links_and_motors = self._model.inertia(self._whole(q))[np.ix_(self.index, self.index)]
        return links_and_motors if motors else links_and_motors - np.diag(self._model.rotor_inertia[self.index])

    def _whole(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return positions of all joints, shape (n,); turning carriers of arms are at 0."""
        cell = self._model.cell
        carriers = {joint for group in cell.groups.values() for joint in cell.carriers_of(group.base)}
        upright = [joint.name in carriers and joint.kind == "revolute" for joint in cell.joints]
        whole = np.where(upright, 0.0, cell.home)
        whole[self.index] = q
        return whole
