"""Streams of torques from a client: the motion control layer, open to the owner of the slots."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from im_core.errors import ImError, LimitError, StateError
from im_mcs.group import ControlledGroup
from im_mcs.group.goals import Goal
from im_mcs.limits.limits import JointLimits
from im_mcs.limits.slots import interface_of
from im_mcs.planning.motions.stream import LAPSED, StreamLease
from im_mcs.protocol.requests import StreamRequest
from im_mcs.safety.stopping_position import stopping_position

Ended = tuple[ControlledGroup, Goal, ImError]


@dataclass
class _TorqueStream:
    group: ControlledGroup
    goal: Goal
    lease: StreamLease
    tau: NDArray[np.float64]


class TorqueStreams:
    """Groups driven by a client's torques, while the lease is renewed and the joints can still be stopped.

    Args:
        limits: Limits of all joints.
        period_s: Servo period [s].
    """

    def __init__(self, limits: JointLimits, period_s: float) -> None:
        self._limits = limits
        self._period_s = period_s
        self._streams: dict[str, _TorqueStream] = {}

    def __bool__(self) -> bool:
        """Whether any group is driven."""
        return bool(self._streams)

    def torque(self, group: str) -> NDArray[np.float64] | None:
        """Return the wanted torques of a group, shape (n,) [Nm or N]; None if the group is not driven."""
        stream = self._streams.get(group)
        return None if stream is None else stream.tau

    def goal(self, group: str) -> Goal | None:
        """The goal of a driven group."""
        stream = self._streams.get(group)
        return None if stream is None else stream.goal

    def require_free(self, group: str) -> None:
        """Check whether a group is free of a torque stream.

        Raises:
            StateError: It is.
        """
        goal = self.goal(group)
        if goal is not None:
            raise StateError(f"group '{group}' is driven by torques (goal {goal.id}); cancel that first", group=group)

    def take_torques(self, group: ControlledGroup, goal: Goal, request: StreamRequest) -> bool:
        """Take the newest torques; the first ones open the goal, later ones renew torques and lease.

        Returns:
            Whether they opened it.

        Raises:
            StateError: The group takes other commands than torques, follows a motion, or a protective stop holds it.
            DataError: A wrong size, or a value that is not finite.
        """
        kind = interface_of(group.controller.name)
        if kind != "effort":
            raise StateError(f"group '{group.name}' takes {kind}, no torques", group=group.name)
        tau = self._limits.check_finite(group.index, request.torques, "stream", "torque")
        lease = StreamLease(request.owner, request.lease_s, self._period_s, "torques")
        stream = self._streams.get(group.name)
        if stream is None:
            group.require_released()
            if group.goals:
                raise StateError(
                    f"group '{group.name}' is moving (goal {group.goals[0].id}); wait for its end or cancel it",
                    group=group.name,
                )
            self._streams[group.name] = _TorqueStream(group, goal, lease, tau)
            return True
        stream.tau, stream.lease = tau, lease
        return False

    def cancel(self, goal_id: int) -> str | None:
        """Return the group of a streaming goal, if there is one."""
        return next((name for name, stream in self._streams.items() if stream.goal.id == goal_id), None)

    def end_streams(self, fault: ImError, groups: Iterable[str] | None = None) -> list[Ended]:
        """Let the laws take over again; all groups if none are named.

        Who did not end his stream himself, by silence, must be silent before he opens another.
        """
        names = list(self._streams) if groups is None else [name for name in groups if name in self._streams]
        streams = [self._streams.pop(name) for name in names]
        for stream in streams:
            if fault.code != LAPSED:
                stream.group.gate.close(stream.lease.owner, stream.lease.seconds, fault)
        return [(stream.group, stream.goal, fault) for stream in streams]

    def tick(self, q: NDArray[np.float64], v: NDArray[np.float64], tick: int) -> list[Ended]:
        """Judge leases, and whether every driven joint could still be stopped within the range.

        Args:
            q: Measured positions of all joints.
            v: Estimated velocities of all joints.
            tick: Number of the tick.
        """
        ended = []
        for name, stream in list(self._streams.items()):
            stream.lease.tick()
            fault = stream.lease.lapsed() or self._beyond(stream.group.index, q, v, tick)
            if fault is not None:
                ended += self.end_streams(fault, (name,))
        return ended

    def _beyond(
        self, index: NDArray[np.intp], q: NDArray[np.float64], v: NDArray[np.float64], tick: int
    ) -> ImError | None:
        limits = self._limits
        rest = stopping_position(q, v, np.zeros_like(v), limits.motion)[index]
        lower = np.minimum(limits.lower, q)[index]
        upper = np.maximum(limits.upper, q)[index]
        outside = (rest < lower) | (rest > upper)
        if outside.any():
            k = int(np.argmax(outside))
            i = int(index[k])
            limit = limits.lower[i] if v[i] < 0.0 else limits.upper[i]
            what = f"position at which it could stop at tick {tick}"
            return _limit_fault(limits, i, float(rest[k]), float(limit), limits.units[i], what)
        fast = np.abs(v[index]) > limits.ceiling.velocity[index]
        if fast.any():
            i = int(index[int(np.argmax(fast))])
            what = f"velocity at tick {tick}"
            return _limit_fault(limits, i, float(v[i]), float(limits.ceiling.velocity[i]), f"{limits.units[i]}/s", what)
        return None


def _limit_fault(limits: JointLimits, i: int, value: float, limit: float, unit: str, what: str) -> LimitError:
    return LimitError(joint=limits.names[i], value=value, limit=limit, unit=unit, what=what)
