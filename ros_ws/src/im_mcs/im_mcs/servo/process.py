"""The servo process: the loop around :class:`im_mcs.servo.core.Mcs`."""

import signal
from contextlib import suppress
from typing import Any

import numpy as np

from im_core import clock, scheduling
from im_core.errors import ImError, LinkError
from im_core.robot import load_cell
from im_mcs.config import McsConfig
from im_mcs.model import Model
from im_mcs.servo.channel import STATES, ServoChannel, sample_message
from im_mcs.servo.core import Mcs
from im_mcs.servo.realtime import Pacer
from im_mcs.state import State
from im_mcs.testbed import TestbedInterface, load_driver

_WAIT_S = 0.05
_SNAPSHOT_TICKS = 4
_SAMPLE_PERIOD_NS = 20_000_000


class ServoProcess:
    """Runs MCS tick by tick until it is told to end.

    Args:
        instance: Which machine on this host.
        config: Configuration.

    Raises:
        ImError: Testbed or owner cannot be reached, or a module of the configuration cannot be loaded.
    """

    def __init__(self, instance: str, config: McsConfig) -> None:
        self._config = config
        model = Model(load_cell())
        channels = [slot.channel for slot in config.joint_slots]
        gripper_channels = [slot.channel for slot in config.gripper_slots]
        self._driver = load_driver(config.testbed.driver, instance=instance, timeout_s=config.testbed.attach_timeout_s)
        if abs(self._driver.period_s - config.servo.period_s) > 1e-9:
            raise LinkError(
                f"the testbed ticks every {self._driver.period_s:g} s, the servo every {config.servo.period_s:g} s;"
                " make them equal"
            )
        self._channel = ServoChannel.attach(instance, model.n, len(gripper_channels), config.testbed.attach_timeout_s)
        self._pending: list[dict[str, Any]] = []
        self._told_state = State.COLD
        testbed = TestbedInterface(self._driver, channels, gripper_channels)
        self._mcs = Mcs(config, model, testbed, self._pending.append)
        self._record = self._channel.snapshot.record()
        self._pacer = Pacer(self._driver.wall_period_s)
        self._real_time = False
        self._linked = True
        self._powered = False
        self._compute_s = 0.0
        self._next_sample_ns = 0
        self._running = True

    def run(self) -> None:
        """Loop until :meth:`stop` or until the owner is gone."""
        self._real_time = scheduling.prefer(self._config.servo.priority, paced=self._driver.wall_period_s > 0.0)
        self._driver.connect()
        self._write_snapshot()
        try:
            while self._running and self._channel.requests.owner_alive():
                self._turn()
        finally:
            self._driver.close()
            self._channel.close()
            scheduling.release()

    def stop(self, *_: object) -> None:
        """End :meth:`run` soon; fit for a signal handler."""
        self._running = False

    def _turn(self) -> None:
        """Wait for a tick and run it; without a tick, look after the link and refuse what cannot be done."""
        try:
            if not self._linked:
                self._driver.connect()
                self._linked = True
                self._pacer.restart()
            while not self._driver.wait(_WAIT_S):
                if not self._running or not self._channel.requests.owner_alive():
                    return
            self._tick()
        except LinkError as error:
            self._linked = False
            self._mcs.lose_testbed(error)
            for message in self._channel.requests.receive_all():
                self._mcs.refuse(message, LinkError(f"the testbed does not answer: {error.message}"))
            self._tell_state()
            self._write_snapshot()
            self._send_events()
            clock.sleep(_WAIT_S)

    def _tick(self) -> None:
        self._pacer.wait()
        began = clock.monotonic()
        if self._pacer.missed_in_row >= self._config.servo.max_overruns:
            self._mcs.stop_all(
                ImError(
                    f"protective stop: {self._pacer.missed_in_row} servo deadlines in a row were missed", code="overrun"
                )
            )
        self._mcs.tick(self._channel.requests.receive_all())
        self._compute_s += 0.01 * (clock.monotonic() - began - self._compute_s)
        self._report()

    def _report(self) -> None:
        """Tell the owner what the tick brought.

        An answer after which time stands still is given only when the testbed has completed the tick: what the owner
        asks for next then falls into the next tick, whoever is faster.
        """
        m = self._mcs.measured
        self._tell_state()
        powered = self._mcs.manager.power
        if powered and not self._powered:
            self._pacer.restart()
        self._powered = powered
        if self._pending and not self._mcs.wants_time:
            self._driver.after_tick(m.tick)
        if self._pending or not self._mcs.wants_time or m.tick % _SNAPSHOT_TICKS == 0:
            self._write_snapshot()
        if not self._next_sample_ns - _SAMPLE_PERIOD_NS <= m.stamp_ns < self._next_sample_ns:
            self._next_sample_ns = (m.stamp_ns // _SAMPLE_PERIOD_NS + 1) * _SAMPLE_PERIOD_NS
            with suppress(LinkError):  # the owner is slow: joint states are a stream of which the newest counts
                self._channel.samples.send(sample_message(m.stamp_ns, m.q, self._mcs.v, self._mcs.tau))
        self._send_events()

    def _tell_state(self) -> None:
        """A change of state is told before the answers that came with it."""
        state = self._mcs.manager.state
        if state is not self._told_state:
            self._told_state = state
            self._pending.insert(0, {"event": "state", "state": state.value, "reason": self._mcs.manager.cause})

    def _send_events(self) -> None:
        if self._pending:
            for message in self._pending:
                self._channel.events.send(message)
            self._pending.clear()
            self._channel.bell.post()

    def _write_snapshot(self) -> None:
        mcs, m, r = self._mcs, self._mcs.measured, self._record
        r["tick"], r["stamp_ns"] = m.tick, m.stamp_ns
        r["state"] = STATES.index(mcs.manager.state)
        r["power"], r["brakes"] = m.power, m.brakes
        r["q"], r["v"], r["tau"], r["setpoint"], r["gripper"] = m.q, mcs.v, mcs.tau, mcs.setpoint, m.gripper
        reserved = np.zeros(len(m.q), dtype=np.bool_)
        for name, group in mcs.groups.items():
            i, monitor = group.index, group.monitor
            reserved[i] = name in mcs.manager.reservations.groups
            r["at_rest"][i] = monitor.at_rest
            r["rest_since_tick"][i] = monitor.since_tick
            r["rest_window"][i] = monitor.window
            r["q_rest"][i] = monitor.q
            r["q_rest_variance"][i] = monitor.variance
        r["reserved"] = reserved
        r["saturations"] = mcs.saturations
        r["ticks"], r["missed_deadlines"] = self._pacer.ticks, self._pacer.missed
        r["max_lateness_s"], r["mean_period_s"] = self._pacer.max_lateness_s, self._pacer.mean_period_s
        r["mean_compute_s"] = self._compute_s
        r["real_time"], r["linked"] = self._real_time, self._linked
        self._channel.snapshot.write(r)


def run(instance: str, config: McsConfig) -> int:
    """Run the servo until SIGTERM or SIGINT; exit code."""
    process = ServoProcess(instance, config)
    numbers = (signal.SIGTERM, signal.SIGINT)
    for number in numbers:
        signal.signal(number, process.stop)
    process.run()
    for number in numbers:
        signal.signal(number, signal.SIG_IGN)
    return 0
