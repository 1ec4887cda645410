"""One group under control: from setpoints to torques, and from a goal to its result."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, StateError
from im_mcs.config import McsConfig
from im_mcs.control import ControlInput, ControlLaws, ControllerSetup, load_controller
from im_mcs.limits import JointLimits
from im_mcs.model import Model
from im_mcs.planning import GroupPlanner, JointPath, Setpoint
from im_mcs.servo.rest import RestMonitor, RestPhase

_ESTOP_FACTOR = 2.0


@dataclass
class Goal:
    """A motion that somebody waits for.

    Attributes:
        id: Request that asked for it.
        since_tick: Tick at which it began.
        fault: Why it ends early, if it does.
    """

    id: int
    since_tick: int
    fault: ImError | None = None


class ControlledGroup:
    """Planner, control law and rest monitor of the joints of one group.

    Args:
        name: Name of the group.
        index: Its joints among all, shape (n,).
        planner: Motion planning layer.
        controller: Motion control layer; a law in force of several.
        monitor: Judge of rest.
        limits: Limits of all joints.
    """

    def __init__(
        self,
        name: str,
        index: NDArray[np.intp],
        planner: GroupPlanner,
        controller: ControlLaws,
        monitor: RestMonitor,
        limits: JointLimits,
    ) -> None:
        self.name = name
        self.index = index
        self.planner = planner
        self.controller = controller
        self.monitor = monitor
        self.engaged = False
        self.goal: Goal | None = None
        self._limits = limits

    @property
    def settled(self) -> bool:
        """At rest, or given up on."""
        return self.monitor.at_rest or self.monitor.timed_out

    def engage(self, q: NDArray[np.float64]) -> None:
        """Hold at ``q``, shape (n,): the first setpoint is the measured position."""
        self.planner.hold(q)
        self.controller.reset()
        self.monitor.restart()
        self.engaged = True

    def disengage(self) -> None:
        """No setpoint, no torque."""
        self.engaged = False
        self.monitor.restart()

    def start(self, goal: Goal, path: JointPath) -> None:
        """Begin to follow a path.

        Raises:
            StateError: Another motion is under way.
        """
        self.require_idle()
        self.goal = goal
        self.monitor.restart()
        self.controller.hold_integral(False)
        self.planner.follow(path)

    def require_idle(self) -> None:
        """Check that no motion is under way.

        Raises:
            StateError: One is.
        """
        if self.goal is not None:
            raise StateError(
                f"group '{self.name}' is moving (goal {self.goal.id}); wait for its end or cancel it", group=self.name
            )

    def stop(self, fault: ImError) -> None:
        """Decelerate; the goal ends with ``fault`` once the group is at rest."""
        if self.goal is not None and self.goal.fault is None:
            self.goal.fault = fault
            self.monitor.restart()
            self.controller.hold_integral(False)
            self.planner.stop()

    def switch(self, law: str) -> None:
        """Let another control law take over, without a bump; the group is then to come to rest anew.

        Raises:
            NotFoundError: The configuration has no such law.
        """
        before = self.controller.name
        self.controller.switch(law)
        if not self.engaged:
            self.controller.reset()
        elif law != before:
            self.monitor.restart()

    def torque(
        self,
        tick: int,
        q: NDArray[np.float64],
        v: NDArray[np.float64],
        gravity: NDArray[np.float64],
        wanted: Setpoint,
    ) -> NDArray[np.float64]:
        """Torques of this tick, shape (n,), for the setpoint that the planner has come to.

        Args:
            tick: Number of the tick.
            q: Measured positions of all joints.
            v: Estimated velocities of all joints.
            gravity: Gravity torques of all joints.
            wanted: Wanted motion of all joints.

        Raises:
            ControlLawError: The control law failed.
        """
        position, setpoint = q[self.index], self.planner.setpoint
        if self.planner.finished and not self.controller.switching:
            self.monitor.update(tick, position, setpoint.q)
            self.controller.hold_integral(self.monitor.phase in (RestPhase.MEASURING, RestPhase.AT_REST))
        return self.controller.torque(
            ControlInput(position, v[self.index], setpoint, gravity[self.index], q, wanted)
        )

    def following_fault(self, tick: int, q: NDArray[np.float64]) -> ImError | None:
        """Stop the motion if a joint is too far off its setpoint; the fault is returned only if that is not enough."""
        error = self.planner.setpoint.q - q[self.index]
        fault = self._limits.following(self.index, error, 1.0, tick)
        if fault is None:
            return None
        self.stop(fault)
        return self._limits.following(self.index, error, _ESTOP_FACTOR, tick)

    def ended(self) -> tuple[Goal, ImError | None] | None:
        """The goal that has just come to its end, and its fault."""
        goal = self.goal
        if goal is None or not self.planner.finished or not self.settled:
            return None
        self.goal = None
        fault = goal.fault
        if fault is None and not self.monitor.at_rest:
            fault = self._not_settled()
        return goal, fault

    def _not_settled(self) -> ImError:
        worst = self.monitor.worst()
        rank = int(self.index[worst])
        joint, unit = self._limits.names[rank], self._limits.units[rank]
        error = float(self.monitor.last_error[worst])
        return ImError(
            f"group '{self.name}' did not settle: {joint} still moves or is off its setpoint, by {error:.3g} {unit} "
            f"after {self.monitor.timeout_s:g} s",
            code="not_settled",
            joint=joint,
            value=error,
            unit=unit,
        )


def make_group(
    name: str, config: McsConfig, model: Model, limits: JointLimits, q_all: NDArray[np.float64]
) -> ControlledGroup:
    """A group as the configuration describes it.

    Args:
        name: Name of the group.
        config: Configuration.
        model: Kinematics and dynamics.
        limits: Limits of all joints.
        q_all: Where all joints are, shape (18,) [rad or m].

    Raises:
        ConfigError: One of its control laws cannot be loaded.
    """
    index = np.array([model.index(joint) for joint in config.groups[name].joints], dtype=np.intp)
    first = config.group_control.get(name, config.control)
    parameters = {**config.switching.laws, first.controller: first.parameters}
    setup = ControllerSetup(
        joints=index,
        period_s=config.servo.period_s,
        model=model,
        torque_limit=limits.torque[index],
        q_nominal=model.cell.home,
        parameters={},
    )
    laws = {law: load_controller(law, replace(setup, parameters=given)) for law, given in parameters.items()}
    cell, servo = model.cell, config.servo
    return ControlledGroup(
        name=name,
        index=index,
        planner=GroupPlanner(q_all[index], servo.period_s, servo.planning_divisor, limits.motion.of(index)),
        controller=ControlLaws(laws, first.controller, servo.period_s, config.switching.handover_s),
        monitor=RestMonitor(cell.per_joint("resolution")[index], cell.per_joint("noise")[index], servo),
        limits=limits,
    )
