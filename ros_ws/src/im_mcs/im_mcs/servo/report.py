"""Reports of the servo about the servo: the snapshot and the samples."""

from typing import Any

import numpy as np

from im_cell.link.fields import Fields
from im_core.rate_groups import RateLoop
from im_mcs.protocol.channel import ServoChannel
from im_mcs.servo.core import Mcs
from im_mcs.state.table import STATES


class Reporter:
    """Writes snapshots and samples into the channel.

    Attributes:
        real_time: Whether the loop has real-time scheduling.
        linked: Whether the testbed answers.

    Args:
        channel: Where to.
        mcs: What of.
        loop: How the loop keeps time; its first function is the tick.
        sample_rate_hz: How often a sample is due, by testbed time [1/s]; never more than one a tick.
    """

    def __init__(self, channel: ServoChannel, mcs: Mcs, loop: RateLoop, sample_rate_hz: float) -> None:
        self.real_time = False
        self.linked = True
        self._channel, self._mcs, self._loop = channel, mcs, loop
        self._record = channel.snapshot.record()
        self._fields = {name: self._record[name] for name in self._record.dtype.names or ()}
        self._newest: Fields | None = None
        self._told: list[tuple[Any, ...]] = []
        self._no_group = np.zeros((), dtype=self._fields["groups"].dtype)
        self._next_sample_ns, self._sample_period_ns = 0, round(1e9 / sample_rate_hz)

    def sample(self) -> None:
        """Write a sample, if due."""
        mcs, m, period_ns = self._mcs, self._mcs.measured, self._sample_period_ns
        if self._next_sample_ns - period_ns <= m.stamp_ns < self._next_sample_ns:
            return
        self._next_sample_ns = (m.stamp_ns // period_ns + 1) * period_ns
        place_s, since_s = np.zeros((2, len(m.q)))
        for group in mcs.groups.values():
            place_s[group.place], since_s[group.place] = group.times
        joints = m.q, mcs.v, mcs.tau, m.age_s, *mcs.loop.setpoint, place_s, since_s, m.brakes
        self._channel.samples.push_record((m.stamp_ns, m.tick, *joints, m.gripper, m.gripper_force, m.wrench))

    def snapshot(self) -> None:
        """The newest state."""
        mcs, m, pacer = self._mcs, self._mcs.measured, self._loop.pacer
        near = mcs.loop.proximity
        values = {
            "tick": m.tick,
            "stamp_ns": m.stamp_ns,
            "state": STATES.index(mcs.manager.state),
            "power": m.power,
            "brakes": m.brakes,
            "q": m.q,
            "v": mcs.v,
            "tau": mcs.tau,
            "age": m.age_s,
            "setpoint": mcs.loop.setpoint[0],
            "setpoint_v": mcs.loop.setpoint[1],
            "setpoint_a": mcs.loop.setpoint[2],
            "gripper": m.gripper,
            "gripper_force": m.gripper_force,
            "wrench": m.wrench,
            "preset": mcs.config.preset.encode(),
            "saturations": mcs.saturations.counts,
            "evidence": mcs.recorder.newest,
            "distance": np.inf if near is None else near.distance,
            "closest": (b"", b"") if near is None else (near.first.encode(), near.second.encode()),
            "ticks": pacer.ticks,
            "missed_deadlines": pacer.missed,
            "max_lateness_s": pacer.max_lateness_s,
            "mean_period_s": pacer.mean_period_s,
            "mean_compute_s": self._loop.groups.statistics()[0].mean_s,
            "real_time": self.real_time,
            "linked": self.linked,
        }
        if self._newest is None:
            self._newest = Fields([self._fields[name] for name in values])
        self._newest.put(tuple(values.values()))
        self._groups(m.stamp_ns)
        self._channel.snapshot.write(self._record)

    def _groups(self, now_ns: int) -> None:
        mcs, fields = self._mcs, self._fields
        rows = fields["groups"]
        told: list[tuple[Any, ...]] = []
        fields["reserved"][...] = False
        for rank, (name, group) in enumerate(mcs.groups.items()):
            i, monitor = group.place, group.monitor
            reservation = mcs.manager.reservations.of(name)
            fields["reserved"][i] = reservation is not None
            fields["place_s"][i], fields["since_s"][i] = group.times
            fields["at_rest"][i] = monitor.at_rest
            fields["rest_since_tick"][i] = monitor.since_tick
            fields["rest_window"][i] = monitor.window
            fields["q_rest"][i] = monitor.q
            fields["q_rest_variance"][i] = monitor.variance
            protective = group.protective
            row = (
                name.encode(),
                STATES.index(mcs.manager.state_of(name)),
                reservation is not None,
                b"" if reservation is None else reservation.owner.encode(),
                0.0 if reservation is None else reservation.left_s(now_ns),
                reservation is not None and reservation.lapsed,
                bool(group.goals),
                group.paused,
                group.speed,
                group.controller.name.encode(),
                group.controller.late,
                b"" if protective is None else protective.message.encode(),
                group.jog_limit,
            )
            told.append(row)
            if rank >= len(self._told) or row != self._told[rank]:  # numpy takes long to write one
                rows[rank] = row
        if len(told) < len(self._told):
            rows[len(told) :] = self._no_group
        self._told = told
