"""What may be asked of the motions of one group: begin, stream, cancel, stop, pause, resume, another speed."""

from collections.abc import Mapping
from typing import Any

from im_core.errors import ImError, StateError
from im_mcs.planning.arguments import LineMove, Policy, check_move, check_policy, check_speed_scale, check_stream
from im_mcs.planning.goals import Current, Goal, Queued
from im_mcs.planning.queue import MotionQueue
from im_mcs.planning.stream import Lease, StreamFollower

_CEILING_STEPS = 20


class GroupMotions(MotionQueue):
    """Motions of a group in the eyes of those who ask for them; knows nothing of torques."""

    def request(self, goal: Goal, arguments: Mapping[str, Any]) -> None:
        """Take up a motion: arguments of a move request; it is prepared in the ticks that follow.

        Raises:
            StateError: Another motion is under way and the policy is to refuse, or a protective stop holds the group.
            DataError: The arguments are not what they should be.
            LimitError: A point is out of a joint's range.
        """
        policy = check_policy(arguments.get("policy", Policy.REFUSE))
        share = check_speed_scale(arguments.get("speed_scale", 0.0))
        self._require_free(policy)
        move = check_move(self.context, arguments["path"])
        queued = Queued(goal, move, policy, share)
        if policy is Policy.REPLACE and isinstance(move, LineMove):
            # a line begins at rest: stop first
            self._end_all(self._replaced(goal))
        self._queue.append(queued)

    def stream(self, goal: Goal, arguments: Mapping[str, Any]) -> bool:
        """Take the newest streaming setpoint; the first one opens the goal, later ones renew target and lease.

        Returns:
            Whether it opened the goal.

        Raises:
            StateError: A motion along a path is under way.
            DataError: The arguments are not what they should be.
            LimitError: The setpoint is beyond a limit.
        """
        current = self._current
        opened = current is not None and current.stream is not None and current.goal.fault is None
        if not opened:
            self._require_free(Policy.REFUSE)
        q, v = check_stream(self.context, arguments)
        lease = Lease(str(arguments.get("owner", "")), float(arguments["lease_s"]), self.planner.period_s)
        if not opened:
            limits, index, planner = self.context.limits, self.context.index, self.planner
            follower = StreamFollower(
                planner.setpoint,
                planner.limits,
                limits.lower[index],
                limits.upper[index],
                planner.period_s,
                planner.divisor,
            )
            self._current = current = Current(goal, stream=follower)
            planner.follower = follower
            self._begun()
        assert current is not None
        assert current.stream is not None
        current.lease = lease
        current.stream.renew(q, v)
        return not opened

    def cancel(self, goal_id: int, fault: ImError) -> None:
        """End a goal early: the motion under way decelerates on its path, one that waits ends at once.

        Motions that wait behind it end too: they were planned from its end.

        Raises:
            StateError: The goal is not under way.
        """
        if self._current is not None and self._current.goal.id == goal_id:
            self._interrupt(fault)
            return
        for rank, queued in enumerate(self._queue):
            if queued.goal.id == goal_id:
                self._end_queued(rank, fault)
                return
        raise StateError(f"goal {goal_id} is not under way", goal=goal_id)

    def stop(self, fault: ImError) -> None:
        """End all goals with ``fault``, decelerating on the path."""
        self._end_all(fault)

    def protective_stop(self, fault: ImError) -> None:
        """Decelerate on the path and hold; goals are suspended until :meth:`resume`, or until patience is over."""
        if self._rates.protective is None and self.goal is not None:
            self._rates.protective = fault
            self._patience_ticks = round(self.context.config.protective.patience_s / self.planner.period_s)

    def pause(self) -> None:
        """Halt on the path; goals go on after :meth:`resume`."""
        self._rates.paused = True

    def resume(self) -> None:
        """Go on along the path after a pause or a protective stop."""
        self._rates.paused = False
        self._rates.protective = None

    def set_speed(self, scale: float) -> None:
        """Share of the planned speed, above 0 and up to 1, for this motion and those after it."""
        self._rates.override = scale

    def set_ceiling(self, scale: float) -> None:
        """Upper bound of the rate, 0 to 1, in steps of 0.05; beside the client's override."""
        self._rates.ceiling = int(scale * _CEILING_STEPS) / _CEILING_STEPS
