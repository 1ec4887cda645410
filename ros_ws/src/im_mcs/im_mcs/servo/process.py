"""The servo process: the loop around :class:`im_mcs.servo.core.Mcs`."""

import math
import signal
from dataclasses import asdict
from typing import Any

from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import LinkError
from im_core.patience import Silence
from im_core.processes import scheduling
from im_core.processes.end_signals import END_SIGNALS, heed_end_signals
from im_core.processes.startup import patience_s
from im_core.rate_groups import RateGroups, RateLoop
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import CellModel
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.protocol.evidence import Recorder
from im_mcs.safety.stop_circuits import StopCircuits
from im_mcs.safety.stop_mark import StopLatch
from im_mcs.servo.awaited import AwaitedOwners
from im_mcs.servo.core import Mcs
from im_mcs.servo.functions import ServoFunctions
from im_mcs.servo.report import Reporter
from im_mcs.state import State
from im_mcs.testbed import TestbedInterface

_WAIT_S = 0.05
_LOOK_S = 0.02
_SNAPSHOT_TICKS = 4
_ORPHAN_S = 5.0
_RATES_S = 1.0
# What is left out where there is no room.
_UNIMPORTANT = ("progress", "rates")
# Share of the ring of events from which on this is left out: the rest is for what must not be lost.
_CROWDED = 0.5


class ServoProcess:
    """Runner of MCS, tick by tick, until the end is requested.

    Raises:
        ImError: Testbed or owner cannot be reached, or a module of the configuration cannot be loaded.
    """

    def __init__(self, instance: str, config: McsConfig) -> None:
        self._config = config
        model = CellModel(load_cell())
        self._testbed = TestbedInterface.load(config.testbed, config.slots, instance)
        if abs(self._testbed.period_s - config.servo.period_s) > 1e-9:
            raise LinkError(
                f"the testbed ticks every {self._testbed.period_s:g} s, the servo every {config.servo.period_s:g} s;"
                " make them equal"
            )
        self._channel = ServoChannel.attach(channel_name(instance), ServoChannel.layout(config), patience_s())
        self._pending: list[dict[str, Any]] = []
        self._left = 0
        self._told: tuple[State, dict[str, State]] = State.COLD, {}
        recorder = Recorder(self._channel.evidence)
        self._on_demand = self._testbed.wall_period_s == 0.0
        awaited = AwaitedOwners(config.servo.owner_patience_s) if self._on_demand else None
        latch = StopLatch(StopCircuits(config.testbed.drivers, instance))
        self._mcs = Mcs(config, model, self._testbed, self._pending.append, recorder, awaited, latch)
        rates = RateGroups(config.servo.period_s)
        rates.register("control", self._control)
        rates.register("report", self._report)
        self._loop = RateLoop(rates, self._testbed.wall_period_s)
        self._pacer = self._loop.pacer
        self._reporter = Reporter(self._channel, self._mcs, self._loop, config.servo.sample_rate_hz)
        self._functions = ServoFunctions(config.functions, self._mcs, rates)
        self._rates_told, self._next_rates = 0, 0.0
        self._powered = False
        self._orphaned = math.inf
        self._owner_runs, self._next_look = True, 0.0
        self._running = True

    def run(self) -> None:
        """Loop until :meth:`stop`; if the owner is gone, until power is off."""
        paced = self._testbed.wall_period_s > 0.0
        self._reporter.real_time = scheduling.prefer(self._config.servo.priority, paced=paced)
        self._testbed.connect()
        self._reporter.snapshot()
        try:
            while self._running and (self._owner_alive() or self._orphan_moves()):
                self._turn()
        finally:
            self._functions.close()
            self._mcs.close()
            self._testbed.close()
            self._channel.close()
            scheduling.release()

    def stop(self) -> None:
        """End :meth:`run` soon; from any thread."""
        self._running = False

    def _owner_alive(self) -> bool:
        """Return whether the owner runs; asked twice a tick, checked every 20 ms (takes a tenth of a tick)."""
        now = clock.monotonic()
        if self._owner_runs and now >= self._next_look:
            self._owner_runs = self._channel.owner_alive()
            self._next_look = now + _LOOK_S
        return self._owner_runs

    def _orphan_moves(self) -> bool:
        """Return whether, without an owner, something is still to be stopped and switched off; within a time limit."""
        now = clock.monotonic()
        if math.isinf(self._orphaned):
            self._orphaned = now
            return True  # a tick to see it
        return self._mcs.wants_time and now - self._orphaned < _ORPHAN_S

    @property
    def _time_passes(self) -> bool:
        """Whether MCS lets simulated time pass."""
        return self._mcs.wants_time and not self._mcs.held

    def _turn(self) -> None:
        """Wait for a tick and run the tick; without a tick, look after the link and refuse impossible requests."""
        self._channel.heartbeat.beat()
        try:
            if not self._reporter.linked:
                self._testbed.connect()
                self._mcs.find_testbed()
                self._reporter.linked = True
                self._reporter.snapshot()  # no tick may come for long, where time stands still
                self._pacer.restart()
            self._pacer.wait()  # before the testbed's tick, which is there by then: one sleep a tick, not two
            if self._wait():
                self._loop.turn()
                self._tell_rates()
        except LinkError as error:
            self._lose(error)

    def _wait(self) -> bool:
        """Wait for a tick; return whether a tick came. At clock factor 0, none comes without a request for time.

        The testbed is silent only while it could tick and this process listens; time in which a busy computer let
        either of them wait does not count. Nor is it silent while whoever has sent a request has not come to asking
        for time yet.

        Raises:
            LinkError: The testbed is gone, or a tick that must come does not.
        """
        silence: Silence | None = None
        while not self._testbed.wait(_WAIT_S):
            self._channel.heartbeat.beat()
            self._send_events()
            asked = not self._channel.requests.empty() and self._testbed.time_asked()
            self._mcs.go_on()
            due = self._time_passes or self._pacer.period_s > 0.0 or asked
            if not due:
                silence = None
            elif silence is None:
                silence = Silence(self._testbed.hardware_pid, longest_look_s=2.0 * _WAIT_S)
            elif silence.look() > self._config.safety.testbed_silence_s:
                silent_s = silence.seconds
                raise LinkError(f"the testbed has not ticked for {silent_s:.1f} s", seconds=silent_s)
            if not self._running or not self._owner_alive():
                return False
        return True

    def _lose(self, error: LinkError) -> None:
        self._reporter.linked = False
        self._mcs.lose_testbed(error)
        for message in self._channel.requests.receive_all():
            self._mcs.refuse(message, LinkError(f"the testbed does not answer: {error.message}"))
        self._tell_state()
        self._reporter.snapshot()
        self._send_events()
        clock.sleep(_WAIT_S)

    def _control(self, _: float) -> None:
        situation = self._mcs.situation
        situation.overruns = self._pacer.missed_in_row
        situation.owner_silence_s = self._channel.heartbeat.silence_s() if self._owner_alive() else math.inf
        self._mcs.tick(self._channel.requests.receive_all())

    def _report(self, _: float) -> None:
        """Report the results of the tick to the owner.

        An answer after which time stands still is given only when the testbed has completed the tick: what the owner
        asks for next then falls into the next tick, whoever is faster.
        """
        m = self._mcs.measured
        self._tell_state()
        powered = self._mcs.manager.power
        if powered and not self._powered:
            self._pacer.restart()
        self._powered = powered
        if self._pending and not self._time_passes:
            self._testbed.after_tick(m.tick)
        last = self._on_demand and not self._time_passes  # none comes for long
        if self._pending or last or m.tick % _SNAPSHOT_TICKS == 0:
            self._reporter.snapshot()
        self._reporter.sample()
        self._send_events()

    def _tell_state(self) -> None:
        """Send a change of state, of any group, before the accompanying answers."""
        manager = self._mcs.manager
        now = manager.state, manager.states
        if now != self._told:
            self._told = now
            groups = {group: state.value for group, state in now[1].items()}
            told: dict[str, Any] = {"event": "state", "state": now[0].value, "groups": groups}
            told |= {"reason": manager.cause, "lost": manager.lost}
            self._pending.insert(self._left, told)

    def _tell_rates(self) -> None:
        """Send the timing of the functions once a second, and at once where one has ended."""
        now, groups = clock.monotonic(), self._loop.groups
        if now >= self._next_rates or groups.ended != self._rates_told:
            self._next_rates, self._rates_told = now + _RATES_S, groups.ended
            self._pending.append({"event": "rates", "functions": [asdict(each) for each in groups.statistics()]})
            self._send_events()

    def _send_events(self) -> None:
        """Send pending events; without room, all but progress and timing is sent later."""
        if not self._pending:
            return
        events, taken = self._channel.events, 0
        for message in self._pending:
            if message["event"] not in _UNIMPORTANT or events.filled < _CROWDED:
                try:
                    events.send(message)
                except LinkError:
                    break
            taken += 1
        self._pending[:] = [message for message in self._pending[taken:] if message["event"] not in _UNIMPORTANT]
        self._left = len(self._pending)
        self._channel.bell.post()


def run(instance: str, config: McsConfig) -> int:
    """Run the servo until a signal asks to end; exit code."""
    process = ServoProcess(instance, config)
    heed_end_signals(lambda _: process.stop())
    process.run()
    signal.pthread_sigmask(signal.SIG_BLOCK, END_SIGNALS)  # while the interpreter ends, when handlers are gone
    return 0
