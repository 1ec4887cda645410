"""Whether a goal is kept on the way, and reached at the end: by tolerances, or by the rest of the arm."""

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.group.goals import Current
from im_mcs.group.rest_monitor import RestMonitor
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.checks.tolerances import TrajectoryTolerances
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.trajectories.trajectory import Setpoint


class GoalCheck:
    """Judge of the goal under way of one group.

    Attributes:
        q: Measured positions, shape (n,) [rad or m].
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        followed: Setpoint, positions and velocities, of the time at which the positions were taken, shape (2, n).
        fault: Why the goal that was found at its end last has not been reached; None: it has.
    """

    def __init__(self, name: str, context: PlanContext, planner: GroupPlanner, monitor: RestMonitor) -> None:
        self._name, self._context, self._planner, self._monitor = name, context, planner, monitor
        self.q, self.v = planner.setpoint.q, planner.setpoint.v
        self.followed = np.array([self.q, self.v])
        self.fault: ImError | None = None

    def on_the_way(self, current: Current, tick: int) -> ImError | None:
        """Return the fault of a trajectory beyond tolerances, or still on the way too late."""
        if current.tolerances is None or current.goal.fault is not None or self._planner.finished:
            return None
        asked = followed = self.followed - np.array([self.q, self.v])
        if current.asked is not None and current.passed_s < current.asked_s:
            wanted, planned = current.asked.at(current.passed_s), self._planner.setpoint
            asked = followed + np.array([wanted.q - planned.q, wanted.v - planned.v])
        return current.tolerances.on_path(asked, followed, tick) or self._missed(current, current.tolerances)

    def at_end(self, current: Current) -> bool:
        """Return whether a goal has ended whose setpoint rests at the end; :attr:`fault` says how."""
        self.fault = None
        if current.tolerances is None:
            if not self._monitor.at_rest and self._monitor.timed_out:
                self.fault = self._not_settled()
            return self._monitor.at_rest or self._monitor.timed_out
        if current.tolerances.reached(self._error(self._planner.setpoint)):
            return True
        self.fault = self._missed(current, current.tolerances)
        return self.fault is not None

    def _error(self, wanted: Setpoint) -> NDArray[np.float64]:
        """Return request minus measurement of position and velocity, shape (2, n)."""
        return np.array([wanted.q - self.q, wanted.v - self.v])

    def _missed(self, current: Current, tolerances: TrajectoryTolerances) -> ImError | None:
        """Return the fault of a goal not reached in the time allowed by the message."""
        planner, monitor = self._planner, self._monitor
        error, late_s = self._error(planner.follower.end_setpoint), current.passed_s - current.asked_s
        settled = planner.finished and (monitor.at_rest or monitor.timed_out)
        return tolerances.at_goal(error, late_s, settled, current.goal.since_tick + current.ticks)

    def _not_settled(self) -> ImError:
        monitor, limits = self._monitor, self._context.limits
        worst = monitor.worst()
        rank = int(self._context.index[worst])
        joint, unit, error = limits.names[rank], limits.units[rank], float(monitor.last_error[worst])
        return ImError(
            f"group '{self._name}' did not settle: {joint} still moves or is off its setpoint, by {error:.3g} {unit} "
            f"after {monitor.timeout_s:g} s",
            code="not_settled",
            joint=joint,
            value=error,
            unit=unit,
        )
