"""One group under control: from setpoints to torques, and from a goal to its result."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.config import McsConfig
from im_mcs.control import ControlInput, ControlLaws, LawSource
from im_mcs.model.places import place_of
from im_mcs.planning.context import PlanContext
from im_mcs.planning.goals import Goal
from im_mcs.planning.motions import GroupMotions
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.queue import Ended
from im_mcs.planning.setpoint import Setpoint
from im_mcs.servo.rest import RestMonitor, RestPhase

if TYPE_CHECKING:
    from im_mcs.servo.core import Mcs

__all__ = ["ControlledGroup", "Goal", "make_group"]


class ControlledGroup(GroupMotions):
    """Motions, control law and rest monitor of the joints of one group.

    In every tick: :meth:`plan`, :meth:`advance`, :meth:`torque`, :meth:`ended`. Tolerances of trajectories are judged
    within :meth:`torque`.

    Attributes:
        index: Its joints among all, shape (n,).
        place: The same, quicker to write to.
        controller: Motion control layer; a law in force of several.
        monitor: Judge of rest.
        engaged: Whether it has setpoints and torques.

    Args:
        name: Name of the group.
        planner: Setpoints.
        context: What motions are planned with.
        controller: Motion control layer.
        monitor: Judge of rest.
    """

    def __init__(
        self,
        name: str,
        planner: GroupPlanner,
        context: PlanContext,
        controller: ControlLaws,
        monitor: RestMonitor,
    ) -> None:
        super().__init__(name, planner, context)
        self.index, self.place = context.index, place_of(context.index)
        self.controller = controller
        self.monitor = monitor
        self.engaged = False
        self._position, self._velocity = planner.setpoint.q, planner.setpoint.v

    @property
    def settled(self) -> bool:
        """At rest, or given up on."""
        return self.monitor.at_rest or self.monitor.timed_out

    @property
    def wants_time(self) -> bool:
        """Whether it moves, prepares a motion or settles, or a suspended goal's patience or a sender's lease runs."""
        return self.engaged and (self.moving or not self.settled)

    def engage(self, q: NDArray[np.float64]) -> None:
        """Hold at ``q``, shape (n,): the first setpoint is the measured position."""
        self.planner.hold(q)
        self._position, self._velocity = q, np.zeros_like(q)
        self.controller.reset()
        self.monitor.restart()
        self.engaged = True

    def disengage(self) -> None:
        """No setpoint, no torque."""
        self.engaged = False
        self.monitor.restart()

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
        self._position, self._velocity = position, v[self.index]
        if self.planner.still:
            if not self.controller.switching:
                self.monitor.update(tick, position, setpoint.q)
                self.controller.hold_integral(self.monitor.phase in (RestPhase.MEASURING, RestPhase.AT_REST))
        elif self.monitor.phase is not RestPhase.MOVING:
            self._begun()
        self._judge(tick)
        return self.controller.torque(ControlInput(position, self._velocity, setpoint, gravity[self.index], q, wanted))

    def following_error(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Setpoint less measured position, shape (n,); ``q`` of all joints."""
        return np.asarray(self.planner.setpoint.q - q[self.index])

    def progress(self) -> dict[str, Any] | None:
        """Of the goal under way: its id, the share of its time that has passed, point, desired and actual motion."""
        current, setpoint = self._current, self.planner.setpoint
        if current is None:
            return None
        return {
            "id": current.goal.id,
            "progress": self.planner.progress,
            "point": self.planner.point,
            "time": current.ticks * self.planner.period_s,
            "desired": {"positions": setpoint.q.tolist(), "velocities": setpoint.v.tolist()},
            "actual": {"positions": self._position.tolist()},
        }

    def ended(self) -> list[Ended]:
        """Goals that ended since the last call: goal, fault, and results (``duration`` [s] of its motion)."""
        current = self._current
        if current is not None:
            self._judge_end(current.goal.fault)
        ended, self._ended = self._ended, []
        return ended

    def _judge_end(self, fault: ImError | None) -> None:
        """End the goal under way if it has come to its end, or has stopped early."""
        current, planner = self._current, self.planner
        assert current is not None
        if fault is not None:
            if planner.still and (current.at_once or self.settled):
                self._end_current(fault)
                planner.hold(planner.setpoint.q)
            return
        if not planner.finished:
            return
        if current.tolerances is not None and current.tolerances.judges_goal:
            error = self._error()
            late_s = current.late_ticks * planner.period_s
            current.late_ticks += 1
            missed = current.tolerances.at_goal(error, late_s, self.settled, current.goal.since_tick + current.ticks)
            if current.tolerances.reached(error) or missed is not None:
                self._end_current(missed)
        elif self.settled:
            self._end_current(None if self.monitor.at_rest else self._not_settled())

    def _error(self) -> NDArray[np.float64]:
        """Setpoint less measured position, and the same of the velocity, shape (2, n)."""
        setpoint = self.planner.setpoint
        return np.array([setpoint.q - self._position, setpoint.v - self._velocity])

    def _judge(self, tick: int) -> None:
        """Interrupt a trajectory whose path tolerance is passed."""
        current = self._current
        if current is not None and current.tolerances is not None and current.goal.fault is None:
            fault = current.tolerances.on_path(self._error(), tick)
            if fault is not None and not self.planner.finished:
                self._interrupt(fault)

    def _begun(self) -> None:
        self.monitor.restart()
        self.controller.hold_integral(False)

    def _not_settled(self) -> ImError:
        worst = self.monitor.worst()
        limits, rank = self.context.limits, int(self.index[worst])
        joint, unit = limits.names[rank], limits.units[rank]
        error = float(self.monitor.last_error[worst])
        return ImError(
            f"group '{self.name}' did not settle: {joint} still moves or is off its setpoint, by {error:.3g} {unit} "
            f"after {self.monitor.timeout_s:g} s",
            code="not_settled",
            joint=joint,
            value=error,
            unit=unit,
        )


def make_group(name: str, config: McsConfig, mcs: "Mcs", laws: LawSource) -> ControlledGroup:
    """A group as the configuration describes it.

    Args:
        name: Name of the group.
        config: Configuration, with the group's preset in force.
        mcs: The machine: model, limits, and where the joints are.
        laws: Makes its control laws.

    Raises:
        ConfigError: One of its control laws cannot be loaded.
    """
    index = np.array([mcs.model.index(joint) for joint in config.groups[name].joints], dtype=np.intp)
    servo, cell, limits = config.servo, mcs.model.cell, mcs.limits
    context = PlanContext(
        model=mcs.model,
        limits=limits,
        index=index,
        frame=config.groups[name].wrist,
        q_all=lambda: mcs.measured.q,
        period_s=servo.period_s * servo.planning_divisor,
        config=config,
    )
    return ControlledGroup(
        name=name,
        planner=GroupPlanner(mcs.measured.q[index], servo.period_s, servo.planning_divisor, limits.motion.of(index)),
        context=context,
        controller=laws.laws_for(config.preset, name),
        monitor=RestMonitor(cell.per_joint("resolution")[index], cell.per_joint("noise")[index], servo),
    )
