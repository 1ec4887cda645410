"""The groups of every preset, made when they are first asked for."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from im_mcs.collision import CollisionMonitor
from im_mcs.config import Group
from im_mcs.control import LawSource
from im_mcs.servo.group import ControlledGroup, make_group

if TYPE_CHECKING:
    from im_mcs.servo.core import Mcs


class Partitions:
    """Makes and keeps the groups of presets, and the collision monitor that knows which joints brake together.

    Args:
        mcs: The machine.
        laws: Makes control laws.
    """

    def __init__(self, mcs: "Mcs", laws: LawSource) -> None:
        self._mcs = mcs
        self._laws = laws
        self._groups: dict[tuple[str, ...], ControlledGroup] = {}
        self._monitors: dict[str, CollisionMonitor] = {}

    def index(self, group: Group) -> NDArray[np.intp]:
        """Ranks of a group's joints."""
        return np.array([self._mcs.model.index(joint) for joint in group.joints], dtype=np.intp)

    def enter(self, preset: str) -> tuple[dict[str, ControlledGroup], CollisionMonitor]:
        """Groups of a preset, and its collision monitor; a group that two presets have in common is one.

        Raises:
            ConfigError: A control law cannot be loaded.
        """
        mcs = self._mcs
        config = mcs.config.with_preset(preset)
        groups = {}
        for name, group in config.groups.items():
            key = (name, *group.joints)
            if key not in self._groups:
                self._groups[key] = make_group(name, config, mcs, self._laws)
            groups[name] = self._groups[key]
            groups[name].monitor.restart()
        if preset not in self._monitors:
            joints = [group.index for group in groups.values()]
            self._monitors[preset] = CollisionMonitor(
                mcs.model, mcs.limits.motion, config.collision, joints, config.servo.period_s
            )
        return groups, self._monitors[preset]
