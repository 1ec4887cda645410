"""A group whose arm follows its setpoints exactly, tick by tick, without the rest of MCS."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.control import ControlInput
from im_mcs.group import ControlledGroup
from im_mcs.group.goals import Goal
from im_mcs.group.rest_monitor import RestMonitor
from im_mcs.limits.configuration import McsConfig, Planning
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.motion_limits import BeyondLimits
from im_mcs.model import CellModel
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.planner import GroupPlanner
from im_mcs.planning.trajectories.trajectory import Setpoint
from im_mcs.protocol.points import TimedPoints, pack_points
from im_mcs.protocol.requests import parse_request

WAY = np.array([0.3, 0.5, 0.3, 0.8, -0.5, 0.5, 0.9, 0.6, 0.9])


def packed(path: Any) -> Any:
    """A path as a request has it: points in time that are listed one by one become columns."""
    listed = path.get("points") if isinstance(path, dict) and path.get("kind") == "trajectory" else None
    if not (isinstance(listed, list) and listed and all(isinstance(p, dict) and "time" in p for p in listed)):
        return path
    names = ("positions", "velocities", "accelerations")
    columns = (np.array([point.get(name, []) for point in listed], dtype=np.float64) for name in names)
    q, v, a = (column if column.size else None for column in columns)
    assert q is not None
    return {**path, "points": pack_points(TimedPoints(np.array([point["time"] for point in listed]), q, v, a))}


class NoLaw:
    """A control law for arms that need none."""

    switching = False
    name = "none"

    def reset(self, before=None) -> None: ...

    def hold_integral(self, hold: bool) -> None: ...

    def command(self, given: ControlInput) -> NDArray[np.float64]:
        return np.zeros_like(given.q)


class Rig:
    """One group, its setpoints so far, and how its goals ended.

    Attributes:
        trace: Setpoints of every tick.
        results: Fault, results and tick of every goal that has ended, by its number.
        error: What the measured position is off the setpoint.
        velocity_error: The same of the velocity.
    """

    def __init__(self, config: McsConfig, model: CellModel, name: str, divisor: int) -> None:
        cell, servo = model.cell, config.servo
        self.all_limits = JointLimits(model.cell, config.limits, config.slots)
        self.index = np.array([model.index(joint) for joint in config.groups[name].joints], dtype=np.intp)
        self.period, self.limits = servo.period_s, self.all_limits.motion.of(self.index)
        self.home = cell.home[self.index]
        self.q_all = cell.home.copy()
        self.context = PlanContext(
            model, self.all_limits, self.index, config.groups[name].frames, lambda: self.q_all, 0.0045 * divisor, config
        )
        noise, resolution = cell.per_joint("noise")[self.index], cell.per_joint("resolution")[self.index]
        self.group = ControlledGroup(
            name,
            GroupPlanner(self.home, servo.period_s, divisor, self.limits),
            self.context,
            NoLaw(),
            RestMonitor(resolution, noise, servo),
        )
        self.group.engage(self.home)
        self.trace = [self.group.planner.setpoint]
        self.results: dict[int, tuple[ImError | None, dict[str, Any], int]] = {}
        self.error = np.zeros(len(self.index))
        self.velocity_error = np.zeros(len(self.index))
        self.tick = 0
        self._number = 0

    def goal(self) -> Goal:
        self._number += 1
        return Goal(self._number, self.tick, round(1e9 * (self.tick + 1) * self.period))

    def parse(self, name: str, **arguments: Any) -> tuple[str, Any]:
        """Name and arguments of a request to the group, as the servo reads them."""
        message = {"request": name, "arguments": {"group": self.group.name, **arguments}}
        planning = self.context.config.planning
        return parse_request(message, planning.max_points, planning.max_trajectory_points)

    def request(self, path: dict[str, Any], **arguments: Any) -> int:
        _, request = self.parse("move", path=packed(path), **arguments)
        goal = self.goal()
        self.group.request(goal, request)
        return goal.id

    def move(self, *points: NDArray[np.float64], blend: float = 0.0, **arguments: Any) -> int:
        return self.request({"kind": "joint", "points": [p.tolist() for p in points], "blend": blend}, **arguments)

    def stream(self, q: NDArray[np.float64], lease_s: float = 10.0, **arguments: Any) -> int:
        goal = self.goal()
        given = {"positions": q.tolist(), "lease_s": lease_s, "owner": "teleop", **arguments}
        self.group.stream(goal, self.parse("stream", kind="setpoint", **given)[1])
        return goal.id

    def ticks(self, count: int) -> None:
        for _ in range(count):
            self.tick += 1
            self.group.plan()
            setpoint = self.group.advance()
            self.trace.append(setpoint)
            self.q_all[self.index] = setpoint.q - self.error
            v = np.zeros_like(self.q_all)
            v[self.index] = setpoint.v - self.velocity_error
            followed = np.array([self.q_all, v])
            followed[:, self.index] = setpoint.q, setpoint.v
            rest = Setpoint.at_rest(self.q_all)
            self.group.command(self.tick, self.q_all.copy(), v, np.zeros_like(v), rest, followed)
            for goal, fault, results in self.group.ended():
                self.results[goal.id] = fault, results, self.tick

    def run(self) -> None:
        """Until time is no longer wanted."""
        for _ in range(30_000):
            if not self.group.wants_time:
                return
            self.ticks(1)
        raise AssertionError("it wants time for ever")

    def code(self, goal: int) -> str | None:
        """Code with which a goal ended, None for success."""
        fault = self.results[goal][0]
        return None if fault is None else fault.code

    @property
    def q(self) -> NDArray[np.float64]:
        return np.array([s.q for s in self.trace])

    @property
    def v(self) -> NDArray[np.float64]:
        return np.array([s.v for s in self.trace])

    @property
    def a(self) -> NDArray[np.float64]:
        return np.array([s.a for s in self.trace])

    def check_motion(self, acceleration: float = 1.01, jerk: float = 1.3) -> None:
        """Setpoints are one continuous motion to the acceleration, and within limits.

        Args:
            acceleration: Tolerated, as a multiple of the limit; a little more than 1 between knots.
            jerk: The same.
        """
        q, v, a, h, limits = self.q, self.v, self.a, self.period, self.limits
        assert (np.abs(v) <= 1.002 * limits.velocity).all()
        assert (np.abs(a) <= acceleration * limits.acceleration).all()
        assert (np.abs(np.diff(a, axis=0)) <= jerk * limits.jerk * h).all()
        # trapezoidal rule: what is said of velocity and acceleration is true of the positions
        assert (np.abs(np.diff(q, axis=0) - h * (v[1:] + v[:-1]) / 2) <= 0.2 * limits.jerk * h**3).all()
        assert (np.abs(np.diff(v, axis=0) - h * (a[1:] + a[:-1]) / 2) <= 0.5 * limits.jerk * h**2).all()


@pytest.fixture(scope="session")
def way() -> NDArray[np.float64]:
    """A move of the left arm."""
    return WAY


@pytest.fixture(scope="session")
def make_rig(config: McsConfig, model: CellModel) -> Callable[..., Rig]:
    def make(divisor: int = 2, name: str = "left", preset: str = "2x9", **changes: Any) -> Rig:
        return Rig(config.with_preset(preset).model_copy(update=changes), model, name, divisor)

    return make


@pytest.fixture(scope="session")
def refusing(config: McsConfig) -> Planning:
    """Trajectories beyond limits are refused, not re-timed."""
    return config.planning.model_copy(update={"beyond_limits": BeyondLimits.REFUSE})


@pytest.fixture
def rig(make_rig: Callable[..., Rig]) -> Rig:
    return make_rig()
