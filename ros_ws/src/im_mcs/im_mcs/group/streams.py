"""Streams of one group: the followers of the newest target, and the gate against senders of an ended stream."""

import math

from im_core.errors import ImError, StateError
from im_mcs.group.rates import Rates
from im_mcs.planning.checks.admission import check_jog, check_stream
from im_mcs.planning.checks.context import PlanContext
from im_mcs.planning.motions.jog import Jog, JogFollower, JogLimit, wrist_tracker
from im_mcs.planning.motions.stream import OpenFollower, StreamFollower
from im_mcs.planning.planner import GroupPlanner
from im_mcs.protocol.requests import StreamRequest


class StreamGate:
    """Whether a group takes streaming setpoints or torques.

    A stream that was ended by a stop, a cancel or a limit, and not by its sender's silence, is not opened again by one
    who goes on sending: he must first be silent for his lease, or the group be resumed.

    Args:
        group: Its name.
        period_s: Servo period [s].
    """

    def __init__(self, group: str, period_s: float) -> None:
        self._group, self._period_s = group, period_s
        self._owner, self._lease_s = "", 0.0
        self._fault: ImError | None = None
        self._ticks_left = 0

    @property
    def closed(self) -> bool:
        """Whether a sender's silence is still waited for."""
        return self._ticks_left > 0

    def close(self, owner: str, lease_s: float, fault: ImError) -> None:
        """Note an ended stream.

        Args:
            owner: Who sent it.
            lease_s: How long he must now be silent, testbed time [s].
            fault: Why it was ended.
        """
        self._owner, self._lease_s, self._fault = owner, lease_s, fault
        self._ticks_left = math.ceil(lease_s / self._period_s)

    def open(self) -> None:
        """Nobody need be silent any more."""
        self._ticks_left = 0

    def tick(self) -> None:
        """One more tick of silence."""
        if self._ticks_left:
            self._ticks_left -= 1

    def require_open(self, owner: str) -> None:
        """Check whether a message may open or renew a stream; a message of another owner always may.

        Raises:
            StateError: His stream was ended, and he has not been silent since; the silence is counted anew.
        """
        if not self.closed:
            return
        if owner != self._owner:
            self.open()
            return
        assert self._fault is not None
        self.close(self._owner, self._lease_s, self._fault)
        raise StateError(
            f"the stream of group '{self._group}' was ended ({self._fault.message}): send nothing for "
            f"{self._lease_s:g} s, its lease, or resume the group, before you stream again",
            group=self._group,
        )


class StreamFollowers:
    """Followers of a group's streams of setpoints or velocities.

    Args:
        context: What motions are planned with.
        planner: Setpoints of the group.
    """

    def __init__(self, context: PlanContext, planner: GroupPlanner) -> None:
        self._context, self._planner = context, planner
        self._tracker = wrist_tracker(context)

    def jog_limit(self, rates: Rates) -> JogLimit:
        """Return the reason for a slower or halted jog."""
        follower, protective = self._planner.follower, rates.stopped
        if not isinstance(follower, JogFollower):
            return JogLimit.NONE
        if protective is not None:
            return JogLimit.COLLISION if protective.code == "collision" else JogLimit.HELD
        if rates.halted:
            return JogLimit.HELD
        return follower.limit or (JogLimit.COLLISION_AHEAD if rates.ceiling < 1.0 else JogLimit.NONE)

    def renewed(self, before: OpenFollower | None, request: StreamRequest) -> StreamFollower | JogFollower:
        """Return the follower of a stream before, or of another kind a new one, with the newest target.

        Raises:
            StateError, NotFoundError, DataError, LimitError: The target is refused.
        """
        context, planner = self._context, self._planner
        if request.kind == "setpoint":
            target = check_stream(context, request)
            if not isinstance(before, StreamFollower):
                limits, index = context.limits, context.index
                lower, upper = limits.lower[index], limits.upper[index]
                start = planner.start_state(1.0)
                before = StreamFollower(start, planner.limits, lower, upper, planner.period_s, planner.divisor)
            before.renew(*target)
            return before
        jog = Jog(check_jog(context, request), request.frame if request.kind == "twist" else "")
        if not isinstance(before, JogFollower):
            start = planner.start_state(1.0)
            before = JogFollower(start, context, self._tracker, planner.period_s, planner.divisor)
        before.renew(jog)
        return before
