"""The groups of every preset, made at the first use."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from im_core import plugins
from im_mcs.collision.guard import GuardedMonitor
from im_mcs.collision.surroundings import NOTHING, CollisionScene
from im_mcs.control import LawSource
from im_mcs.group import ControlledGroup
from im_mcs.group.rest_monitor import RestMonitor
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning.checks.context import GENERATOR, PlanContext
from im_mcs.planning.planner import GroupPlanner


class Partitions:
    """Groups of presets, with the collision monitor for joints braking together.

    Args:
        config: Configuration.
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        laws: Makes control laws.
        q_all: Gives the positions of all joints now, shape (n,) [rad or m].

    Raises:
        ConfigError: A trajectory generator cannot be loaded.
    """

    def __init__(
        self,
        config: McsConfig,
        model: CellModel,
        limits: JointLimits,
        laws: LawSource,
        q_all: Callable[[], NDArray[np.float64]],
    ) -> None:
        self._config, self._model, self._limits, self._laws, self._q_all = config, model, limits, laws, q_all
        for generator in config.planning.generators.model_dump().values():
            plugins.load(generator, None, GENERATOR)  # refused now, not at the first motion
        self._groups: dict[tuple[str, ...], ControlledGroup] = {}
        self._monitors: dict[str, GuardedMonitor] = {}
        self._around = NOTHING

    def enter(self, preset: str) -> tuple[dict[str, ControlledGroup], GuardedMonitor]:
        """Return groups of a preset, and the collision monitor; a common group of two presets is one.

        Raises:
            ConfigError: A control law or the collision monitor cannot be loaded.
        """
        config = self._config.with_preset(preset)
        groups = {}
        for name, group in config.groups.items():
            key = (name, *group.joints)
            if key not in self._groups:
                self._groups[key] = self._make(name, config)
            groups[name] = self._groups[key]
            groups[name].monitor.restart()
        if preset not in self._monitors:
            joints = [group.index for group in groups.values()]
            self._monitors[preset] = monitor = GuardedMonitor(
                config.collision, self._model, self._limits.motion, joints, config.servo.period_s
            )
            if self._around != NOTHING:
                monitor.surround(self._around)
        return groups, self._monitors[preset]

    def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and contacts.

        Raises:
            CollisionMonitorError: A monitor takes none.
        """
        for monitor in self._monitors.values():
            monitor.surround(around)
        self._around = around

    def end_contacts(self, stamp_ns: int) -> None:
        """Watch pairs again after the end of their lease, at a testbed time [ns]."""
        if (around := self._around.at(stamp_ns)) is not self._around:
            self.surround(around)

    def _make(self, name: str, config: McsConfig) -> ControlledGroup:
        """Make a group of the preset in force."""
        index = np.array([self._model.index(joint) for joint in config.groups[name].joints], dtype=np.intp)
        servo, cell, limits = config.servo, self._model.cell, self._limits
        context = PlanContext(
            model=self._model,
            limits=limits,
            index=index,
            frames=config.groups[name].frames,
            q_all=self._q_all,
            period_s=servo.period_s * servo.planning_divisor,
            config=config,
        )
        return ControlledGroup(
            name=name,
            planner=GroupPlanner(self._q_all()[index], servo.period_s, servo.planning_divisor, limits.motion.of(index)),
            context=context,
            controller=self._laws.laws_for(config.preset, name),
            monitor=RestMonitor(cell.per_joint("resolution")[index], cell.per_joint("noise")[index], servo),
        )
