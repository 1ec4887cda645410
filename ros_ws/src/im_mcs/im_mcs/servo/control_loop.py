"""From setpoints to commands, for all groups under control: plan, limit, control, limit; then look around."""

from collections.abc import Container, Iterable, Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError
from im_mcs.collision import Proximity
from im_mcs.collision.guard import GuardedMonitor
from im_mcs.group import ControlledGroup
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.saturation import Saturations
from im_mcs.limits.slots import Interface
from im_mcs.limits.vectors import clip
from im_mcs.model import ControlledModel
from im_mcs.model.dynamics import Place
from im_mcs.planning import Setpoint
from im_mcs.safety import Reaction, SafetyFinding, SetpointLimiter
from im_mcs.safety.setpoint_history import SetpointHistory
from im_mcs.safety.watches import ESTOP_FACTOR
from im_mcs.servo.torque_stream import Ended, TorqueStreams
from im_mcs.testbed import Measured

_LOOPS_OF_ROBOTS: tuple[Interface, Interface] = ("velocity", "position")
# largest step of a position in a tick, as a multiple of that of a joint at its largest velocity
_STEP = 1.1
# for how long a joint that a law has just left is expected where it was sent; a robot is told where to stand by then
_LEFT_TICKS = 50


class ControlLoop:
    """Steps between reading and writing the slots.

    Attributes:
        engaged: Groups under control.
        torque_streams: Groups whose torques come from a client.
        ended: Goals of such groups that ended in this tick.
        model: Dynamics in the eyes of the control laws.
        setpoint: Positions, velocities, accelerations that are followed, shape (3, n).
        command: Torque, velocity or position of each joint, as its slot takes them, shape (n,). Without control a joint
            gets no torque and no velocity, and the position at which it is.
        proximity: What the collision monitor said last; None while nothing is under control.

    Args:
        config: Configuration.
        limits: Limits of all joints.
        model: Dynamics in the eyes of the control laws.
        saturations: Counts what is cut.
        q: Where all joints are, shape (n,).
    """

    def __init__(
        self,
        config: McsConfig,
        limits: JointLimits,
        model: ControlledModel,
        saturations: Saturations,
        q: NDArray[np.float64],
    ) -> None:
        period_s = config.servo.period_s
        plan_s = period_s * config.servo.planning_divisor
        self.engaged: list[ControlledGroup] = []
        self.torque_streams = TorqueStreams(limits, period_s)
        self.ended: list[Ended] = []
        self.model = model
        self.setpoint = _standing(q)
        self.command = np.zeros(model.n)
        self.proximity: Proximity | None = None
        self._config, self._limits = config, limits
        self._velocities, self._positions = (list(config.ranks_of(kind)) for kind in _LOOPS_OF_ROBOTS)
        self._largest = limits.torque.copy()
        self._largest[self._velocities] = limits.ceiling.velocity[self._velocities]
        self._largest[self._positions] = _STEP * period_s * limits.ceiling.velocity[self._positions]
        self._least = -self._largest
        self._stands, self._left = np.full(model.n, np.nan), 0
        self._saturations = saturations
        self._free(slice(None), q)
        self._limiter = SetpointLimiter(limits, period_s, plan_s, config.safety.jerk_factor, saturations)
        self._past = SetpointHistory(q, period_s, config.safety.driver_age_estop_s)

    @property
    def tau(self) -> NDArray[np.float64]:
        """Torques, shape (n,) [Nm or N]; 0 of joints that take other commands."""
        if not self._velocities and not self._positions:
            return self.command
        tau = self.command.copy()
        tau[self._velocities + self._positions] = 0.0
        return tau

    def following_error(self, m: Measured) -> NDArray[np.float64]:
        """Return the last setpoints at the times of the readings less the readings, shape (n,) [rad or m]."""
        error: NDArray[np.float64] = self._past.at(m.age_s)[0] - m.q
        return error

    def moving(self, groups: Container[str]) -> str | None:
        """Return one of the groups with a goal."""
        moving = (g.name for g in self.engaged if g.goals or self.torque_streams.goal(g.name) is not None)
        return next((name for name in moving if name in groups), None)

    def engage(self, groups: Iterable[ControlledGroup], q: NDArray[np.float64]) -> None:
        """Let groups hold the measured place, ``q`` of all joints."""
        for group in groups:
            group.engage(q[group.index])
            self._limiter.hold(group.index, q[group.index])
            if group not in self.engaged:
                self.engaged.append(group)
                self._stands[group.index] = np.nan

    def hand_over(self, former: Sequence[ControlledGroup], heirs: Iterable[ControlledGroup]) -> None:
        """Let groups hold the joints of others, which end, at the same setpoints, with commands that go on."""
        for group in former:
            group.disengage()
        for group in heirs:
            group.engage(self.setpoint[0, group.index], self.command[group.index])
            self.engaged.append(group)
        self.engaged = [group for group in self.engaged if group.engaged]

    def disengage(self, groups: Container[str]) -> None:
        """End setpoints and commands of groups, from the current tick on."""
        self.command = self.command.copy()
        for group in self.engaged:
            if group.name in groups:
                group.disengage()
                self._limiter.release(group.index)
                self._stands[group.index], self._left = self.command[group.index], _LEFT_TICKS
                self._free(group.place, self._q)
        self.engaged = [group for group in self.engaged if group.engaged]
        if not self.engaged:
            self.proximity = None

    def run(self, m: Measured, v: NDArray[np.float64]) -> list[SafetyFinding]:
        """Run one tick, up to the commands; return the findings.

        Args:
            m: What the slots say.
            v: Estimated velocities, shape (n,).
        """
        self.setpoint = wanted = _standing(m.q)
        self.model.advance()
        self._q = m.q
        self._left -= 1
        if not self.engaged:
            if self._positions:
                self._free(slice(None), m.q)
            self._past.push_setpoint(wanted)
            return []
        try:
            self._plan(wanted, m, v)
            self._past.push_setpoint(wanted)
            self._control(m, v, Setpoint(wanted[0], wanted[1], wanted[2]))
        except ImError as fault:  # of a control law, or of a setpoint that is none
            return [_estop(fault, m.tick)]
        return []

    def look_around(self, m: Measured, v: NDArray[np.float64], collision: GuardedMonitor) -> list[SafetyFinding]:
        """Check the distances along the current tick's setpoints as a bound for the setpoints of the next tick.

        The slots need not wait for it, nor for what can be prepared of these.

        Args:
            m: What the slots said.
            v: Estimated velocities, shape (n,).
            collision: Watches distances.
        """
        if not self.engaged:
            return []
        try:
            return self._look_around(m, v, self.setpoint, collision)
        except ImError as fault:
            return [_estop(fault, m.tick)]

    def _plan(self, wanted: NDArray[np.float64], m: Measured, v: NDArray[np.float64]) -> None:
        if self.torque_streams:
            self.ended += (ended := self.torque_streams.tick(m.q, v, m.tick))
            self.engage((group for group, _, _ in ended), m.q)
        for group in self.engaged:
            index = group.index
            if self.torque_streams.torque(group.name) is None:
                group.plan()
                setpoint = group.advance()
                place = group.place
                wanted[0, place], wanted[1, place], wanted[2, place] = setpoint.q, setpoint.v, setpoint.a
            else:
                group.hold(m.q[index])
                group.monitor.restart()
                self._limiter.place(index, m.q[index])
        if self._limiter.limit(wanted):
            for group in self.engaged:
                cut = [self._limits.names[i] for i in group.index if self._limiter.cut[i]]
                group.cut(Setpoint(*(row[group.index] for row in wanted)), cut, m.tick)

    def _look_around(
        self, m: Measured, v: NDArray[np.float64], wanted: NDArray[np.float64], collision: GuardedMonitor
    ) -> list[SafetyFinding]:
        velocity = wanted[1]
        if self.torque_streams:
            velocity = velocity.copy()  # driven by torques, a group has no setpoint: its readings count
            for group in self.engaged:
                if self.torque_streams.torque(group.name) is not None:
                    velocity[group.index] = v[group.index]
        curves = {
            int(group.index[0]): ahead
            for group in self.engaged
            if (ahead := group.planner.ahead) is not None and self.torque_streams.torque(group.name) is None
        }
        near = self.proximity = collision.update(m.q, velocity, wanted[2], curves)
        for group in self.engaged:
            group.rates.set_ceiling(near.speed_ceiling)
            group.planner.look_ahead()
        if not near.stop:
            return []
        fault = ImError(
            f"{near.first} and {near.second} come too close: {near.distance:.4f} m apart after braking now, "
            f"{self._config.collision.stop_m:g} m are allowed",
            code="collision",
            first=near.first,
            second=near.second,
            distance=near.distance,
            tick=m.tick,
        )
        return [SafetyFinding(Reaction.PROTECTIVE_STOP, fault)]

    def _control(self, m: Measured, v: NDArray[np.float64], setpoint: Setpoint) -> None:
        before = self.command
        self.command = wanted = before.copy()
        self._free(slice(None), m.q)
        gravity, followed = self.model.gravity(m.q), self._past.at(m.age_s)
        for group in self.engaged:
            group.feel(m.tick, m.q, m.wrench)
            driven = self.torque_streams.torque(group.name)
            own = group.command(m.tick, m.q, v, gravity, setpoint, followed) if driven is None else driven
            wanted[group.place] = own
        least, largest = self._least, self._largest
        if self._positions:  # no law makes a joint leap, or leave its range
            least, largest, ranks = least.copy(), largest.copy(), self._positions
            last, limits = before[ranks], self._limits
            least[ranks] = np.maximum(least[ranks] + last, np.minimum(limits.lower[ranks], last))
            largest[ranks] = np.minimum(largest[ranks] + last, np.maximum(limits.upper[ranks], last))
        self.command = clip(wanted, least, largest)
        if self.command.tobytes() != wanted.tobytes():
            cut = self.command != wanted
            torques = cut.copy()
            torques[self._velocities + self._positions] = False
            self._saturations.add("torque", torques)
            self._saturations.add("velocity", cut & ~torques)

    def _free(self, place: Place, q: NDArray[np.float64]) -> None:
        """Give joints the commands of joints without control: where they are, for those that take positions.

        A joint without a reading keeps its position. So does one just left by its law, of which a reading is off the
        last command by more than any error that is followed: the joint is not there, and a robot would go there.

        Args:
            place: Which joints.
            q: Where all joints are, shape (n,) [rad or m].
        """
        self._q = q
        if not self._positions:
            self.command[place] = 0.0
            return
        before, free = self.command, np.zeros_like(self.command)
        leapt = (self._left > 0) & (np.abs(q - self._stands) > ESTOP_FACTOR * self._limits.following_error)
        here = np.where(leapt, self._stands, np.where(np.isfinite(q), q, before))
        free[self._positions] = here[self._positions]
        self.command[place] = free[place]


def _estop(fault: ImError, tick: int) -> SafetyFinding:
    told = ImError(f"{fault.message}, at tick {tick}", code=fault.code)
    told.facts.update(fault.facts)
    return SafetyFinding(Reaction.ESTOP, told)


def _standing(q: NDArray[np.float64]) -> NDArray[np.float64]:
    setpoint = np.zeros((3, len(q)))
    setpoint[0] = q
    return setpoint
