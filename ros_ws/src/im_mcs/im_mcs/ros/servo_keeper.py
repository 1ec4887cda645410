"""The servo process in the life of the node: start, heartbeats, end, and changes of the state."""

from collections import deque
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from im_cell.link import ClockEnd
from im_core import clock, names
from im_core.errors import ImError, LinkError, StateError
from im_core.processes.process import ChildProcess
from im_core.processes.startup import patience_s
from im_core.ros.calls import run_in_thread
from im_core.ros.coroutines import Promise, calling
from im_core.ros.node import ManagedNode
from im_core.shm import dead_owner
from im_mcs.client.emergency_stop import EmergencyStop
from im_mcs.client.servo_client import OnState, ServoClient
from im_mcs.client.time_source import FlowingTime, TestbedTime
from im_mcs.limits.configuration import McsConfig
from im_mcs.protocol.channel import ServoChannel, channel_name
from im_mcs.ros.lifecycle import Lifecycle
from im_mcs.safety.stop_circuits import StopCircuits
from im_mcs.safety.stop_mark import StopLatch
from im_mcs.state import POWERED, UNCONFIGURED_MESSAGE, Event, State, lifecycle_of
from im_mcs.testbed.driver import PowerReading, asks_for_time

FINALIZED_MESSAGE = (
    "/mcs is finalized by the lifecycle transition shutdown; the machine starts it again within seconds, "
    "a node that runs alone is started again by hand"
)

POLL_S = 0.02
"""How often the node looks after it [s]."""
_LONGER = 1.1
"""The servo process says itself for what it waited in vain; only if it does not, the node says so."""
_TELL_AGAIN_S = 0.5
"""How soon a servo that is not stopped, and should be, is told again [s]."""
_UNHEARD_S = 30.0
"""For how long the servo may let requests lie [s]. Where its testbed is silent it refuses them itself, and sooner, but
for the time in which a busy computer gives that no processor."""
_DISK_S = 30.0
"""How long the disk may take to have the mark of a stop [s]."""
_FRESH_S = 0.1
"""Power and brakes of a servo that has been silent for longer are read past it [s]."""


class ServoOwner:
    """Running servo process, with the way to the servo.

    Must be made in a thread that lives as long as the node: the process dies with the thread that started it.

    Args:
        config: Configuration.
        config_file: Where it came from; None: the one of the package.
        on_state: Told of every change of state, in another thread.

    Raises:
        OSError: It cannot be started; nothing is left behind.
    """

    def __init__(self, config: McsConfig, config_file: Path | None, on_state: OnState) -> None:
        instance = names.instance()
        self._on_state = on_state
        self._timeout_s = _LONGER * patience_s()
        self._on_demand = asks_for_time(config.testbed.drivers[config.testbed.clock].driver)
        self._deadline = clock.monotonic() + self._timeout_s
        self._channel = ServoChannel.create(channel_name(instance), ServoChannel.layout(config))
        servo = config.servo
        changed = [config.preset, repr(servo.period_s), repr(servo.sample_rate_hz)]
        arguments = [instance, str(config_file or ""), *changed]
        try:
            self.process = ChildProcess.of_module("im_mcs.servo", arguments, log=names.run_dir() / "servo.log")
        except OSError:
            self._channel.close()
            raise
        self._client: ServoClient | None = None

    @property
    def client(self) -> ServoClient:
        """Way to the servo, once ready."""
        if self._client is None:
            raise StateError("the servo process is not ready yet")
        return self._client

    def ready(self) -> bool:
        """Return whether the servo runs and holds the testbed; ask until true.

        Raises:
            LinkError: It ended, or was not ready in time; the message says why.
        """
        if self._client is not None:
            return True
        if self._channel.snapshot.sequence == 0:
            self.process.check()
            if clock.monotonic() > self._deadline:
                raise LinkError(f"the servo process was not ready within {self._timeout_s:g} s")
            return False
        time = TestbedTime(ClockEnd.attach(names.instance(), 1.0)) if self._on_demand else FlowingTime()
        self._client = ServoClient(self._channel, time, self._on_state)
        return True

    def close(self) -> None:
        """End the process; the testbed brakes. Nothing is left behind."""
        if self._client is not None:
            self._client.close()
        self.process.stop()
        self._channel.close()


class ServoKeeper:
    """The servo process in the life of the node.

    Args:
        node: The node.
        lifecycle: Of the node; follows what happens in the servo.
        config_file: Configuration of the servo; None: that of the package.
        silence_s: Wall time without a heartbeat of the servo, after which requests are refused [s].
        circuits: The second way to the power.
        changed: Called in the node's loop after every change of state.
    """

    def __init__(
        self,
        node: ManagedNode,
        lifecycle: Lifecycle,
        config_file: Path | None,
        silence_s: float,
        circuits: StopCircuits,
        changed: Callable[[], None],
    ) -> None:
        self._node, self._lifecycle = node, lifecycle
        self._circuits, self._latch = circuits, StopLatch(circuits)
        self._stop = EmergencyStop(circuits, self._latch)
        self._told_again, self._resets = 0.0, 0
        self._testbed_lost = self._servo_lost = False
        self._silence_s = silence_s
        self._reason = ""
        died = dead_owner(channel_name(names.instance()))
        self._death = f"/mcs has died (process {died}) and was started again" * bool(died)
        self._hang: LinkError | None = None
        self._config_file = config_file
        self._changed = changed
        self._owner: ServoOwner | None = None
        self._starting: tuple[ServoOwner, Promise] | None = None
        self._changes: deque[tuple[State, dict[str, str], str, bool]] = deque()
        self._explained = State.COLD

    @property
    def running(self) -> bool:
        """Whether there is a servo process to talk to."""
        return self._owner is not None

    @property
    def reason(self) -> str:
        """Reason of the state of MCS, e.g. the cause of an emergency stop; the silent process, if any; or empty."""
        if self._owner is not None and self._hang is None:
            linked = self._owner.client.snapshot()["linked"]
            here = self._reason or self._stop.cause or ("" if linked else "the testbed does not answer")
            return here or self._death
        what = (self._reason or self._death) if self._hang is None else self._hang.message
        latched = f"an emergency stop is latched ({self._stop.cause}); reset it (/mcs/reset)"
        return "; ".join(filter(None, (what, latched if self._stop.cause else "")))

    @property
    def explained(self) -> bool:
        """Whether :attr:`reason` is that of :attr:`state`: a snapshot shows a state before its cause is heard."""
        if self._owner is None or self._hang is not None or self._stop.cause:
            return True
        return self._owner.client.state() is self._explained

    @property
    def lost(self) -> bool:
        """Whether MCS would be cold but for a loss of the servo or testbed, without any stop."""
        if self._owner is None:
            stopped = bool(self._stop.cause) and not self._testbed_lost
            return self._servo_lost and not stopped and self._lifecycle.state == "unconfigured"
        return self._testbed_lost and self.state is State.ESTOPPED

    @property
    def recovering(self) -> bool:
        """Whether a servo is being started, or an emergency stop reset."""
        return self._starting is not None or self._resets > 0

    @property
    def read_past(self) -> PowerReading | None:
        """Power and brakes, read past a servo without present readings; None if the servo measures both.

        Hardware that cannot be asked is told as it is without a servo.
        """
        if self._owner is not None and self._hang is None:
            client = self._owner.client
            if client.silence_s() < _FRESH_S and client.snapshot()["linked"]:
                return None
        return self._circuits.reading() or PowerReading(power=False, braked=True)

    @property
    def stop_cause(self) -> str:
        """Cause of a latched emergency stop, or empty; outlives the servo process."""
        return self._stop.cause

    @property
    def state(self) -> State:
        """Present state of MCS; after an emergency stop estopped, against the last report of a hanging servo."""
        if self._owner is None:
            return State.UNCONFIGURED
        return State.ESTOPPED if self._stop.cause else self._owner.client.state()

    def client(self) -> ServoClient:
        """The way to the servo.

        Raises:
            StateError: MCS is unconfigured, or finalized.
        """
        if self._lifecycle.state == "finalized":
            raise StateError(FINALIZED_MESSAGE, state=State.UNCONFIGURED.value)
        if self._owner is None:
            reason = f" ({self.reason})" if self.reason else ""
            begins = f"{self.reason}; it is not configured yet, ask again"
            told = begins if self._death and not self._reason else UNCONFIGURED_MESSAGE + reason
            raise StateError(told, state=State.UNCONFIGURED.value)
        return self._owner.client

    def explain(self, error: ImError) -> ImError:
        """Return the error; to a refusal in the state left by the last ``/mcs`` death, add the death as the cause."""
        if not self._death or error.facts.get("state") != State.COLD.value:
            return error
        return ImError.restored(error.code, f"{error.message}; the cause of this state: {self._death}", error.facts)

    def start_blocking(self, config: McsConfig) -> None:
        """Start the servo process and wait until the servo holds the testbed.

        Raises:
            ImError: It cannot be started, or the testbed does not answer.
        """
        owner = self._new_owner(config)
        try:
            while not owner.ready():
                clock.sleep(POLL_S)
        except ImError:
            owner.close()
            raise
        self._take_owner(owner)

    async def start(self, config: McsConfig) -> None:
        """As :meth:`start_blocking`, while the node goes on.

        Raises:
            ImError: It cannot be started, or the testbed does not answer.
        """
        owner: ServoOwner | None = None
        try:
            owner = self._new_owner(config)
            self._starting = owner, self._node.promise()
            await self._starting[1]
        except Exception as error:
            if owner is not None:
                owner.close()
            self._reason, self._servo_lost = str(error), True
            raise
        finally:
            self._starting = None
        self._take_owner(owner)

    def estop(self, reason: str) -> str:
        """Stop at once, in any state of MCS, and latch the stop; describe the result in a sentence. From any thread."""
        owner, hang = self._owner, self._hang
        said = self._stop.stop(reason, None if owner is None else owner.client)
        self._testbed_lost = False  # before the answer: a reservation right after the answer mends no requested stop
        self._node.spawn(calling(self._follow_stop))
        if owner is None:
            return f"{self.reason}; {said}"
        return f"MCS is {self.state.value}; {said}" + (f": {hang.message}" if hang is not None else "")

    def _follow_stop(self) -> None:
        """Let the node follow a requested stop; in the loop."""
        self.follow()
        self._changed()
        self._node.spawn(self._synchronise())

    async def reset(self, request: Callable[[Event, dict[str, Any]], Awaitable[object]]) -> None:
        """End an emergency stop, if the cause is gone; nothing moves.

        Raises:
            ImError: The cause is not gone, there is nothing to reset, or it was stopped again meanwhile.
        """
        count, unserved = self._stop.count, self._owner is None
        if self._owner is None:
            if not self._stop.cause:
                self.client()
        else:
            self._resets += 1
            try:
                if self._stop.cause and self._owner.client.state() is not State.ESTOPPED:
                    await request(Event.ESTOP, {"reason": self._stop.cause})  # it has not heard of it, and shall
                await request(Event.RESET, {})
            finally:
                self._resets -= 1
        self._stop.end(count, forget=unserved)
        self._testbed_lost = False
        self._changed()

    async def _synchronise(self) -> None:
        """Let the mark of a stop outlive a loss of power, too."""
        try:
            await run_in_thread(self._node, self._latch.synchronise, timeout_s=_DISK_S)
        except ImError as error:
            self._node.get_logger().error(f"a loss of power would end the emergency stop: {error.message}")

    def _hold(self, cause: str) -> None:
        """Remember an emergency stop; the first cause stays."""
        if not self._stop.cause:
            self._stop.cause = cause
            self._changed()
            self._node.spawn(self._synchronise())

    def _take_owner(self, owner: ServoOwner) -> None:
        """Take over a servo process; pass on an emergency stop latched meanwhile, or found."""
        self._owner, self._explained = owner, owner.client.state()
        if not self._stop.cause and self._circuits.is_cut():
            self._hold("the emergency stop circuit was found cut")
        if self._stop.cause:
            owner.client.send(Event.ESTOP, {"reason": self._stop.cause})

    def close(self) -> None:
        """End the servo process; the testbed brakes without a servo. Forget the reports."""
        owner, self._owner, self._hang = self._owner, None, None
        if owner is not None:
            owner.close()
        self._changes.clear()
        self._reason, self._servo_lost = "", False

    def poll(self) -> None:
        """Look after everything; to be called every :data:`POLL_S` in the node's loop.

        The heartbeat to the servo is given here, so that a node whose loop stands still is noticed.
        """
        self._await_start()
        owner = self._owner
        if owner is None:
            self.follow()
            return
        try:
            owner.process.check()
        except LinkError as error:
            self._node.get_logger().error(error.message)
            owner.client.give_up(error)
            self.follow()  # what it told last counts, an emergency stop above all
            self.close()
            self._reason, self._servo_lost = error.message, True
            self.follow()
            self._changed()
            return
        owner.client.beat()
        self._listen_to(owner.client)
        self.follow()
        self._tell_again(owner.client)

    def _tell_again(self, client: ServoClient) -> None:
        """Stop a servo without knowledge of an emergency stop: the servo hung then, or the testbed was away."""
        if not self._stop.cause or self._resets or self._hang is not None or client.state() is State.ESTOPPED:
            return
        if clock.monotonic() > self._told_again:
            self._told_again = clock.monotonic() + _TELL_AGAIN_S
            client.send(Event.ESTOP, {"reason": self._stop.cause})

    def follow(self) -> None:
        """Let the lifecycle and ``/mcs/state`` follow the events in the servo."""
        lifecycle = self._lifecycle
        wanted = lifecycle_of(self.state)
        if lifecycle.state == "inactive" and wanted == "active":
            lifecycle.follow("activate")
        if lifecycle.state == "active" and wanted != "active":
            lifecycle.follow("deactivate")
        if lifecycle.state == "inactive" and wanted == "unconfigured":
            lifecycle.follow("cleanup")
        while self._changes:
            state, groups, self._reason, lost = self._changes.popleft()
            self._explained = state
            if state in POWERED:
                self._death = ""
            if state is State.ESTOPPED:
                # told again with each change of a group; a stop that somebody asked for before it is no loss
                self._testbed_lost = lost and (self._testbed_lost or not self._stop.cause)
                self._hold(self._reason)
            each = ", ".join(f"{group} {its}" for group, its in groups.items())
            text = f"MCS is {state.value}" + (f" ({each})" if each else "")
            text += f": {self._reason}" if self._reason else ""
            logger = self._node.get_logger()
            logger.warning(text) if self._reason else logger.info(text)
            self._changed()

    def _new_owner(self, config: McsConfig) -> ServoOwner:
        self._reason = ""
        try:
            return ServoOwner(config, self._config_file, self._take_state)
        except OSError as error:
            raise LinkError(f"the servo process cannot be started: {error}") from error

    def _listen_to(self, client: ServoClient) -> None:
        """Refuse requests while the running servo gives or hears no heartbeat; no client waits for the servo."""
        why = ""
        if client.silence_s() > self._silence_s:
            why = f"it has given no heartbeat for {self._silence_s:g} s"
        elif client.unheard_s() > _UNHEARD_S:
            why = f"it gives heartbeats, and has heard no request for {_UNHEARD_S:g} s"
        if not why:
            if self._hang is not None:
                self._hang = None
                client.resume()
                self._node.get_logger().warning("the servo process gives heartbeats again, and hears requests")
                self._changed()
            return
        if self._hang is None:
            self._hang = LinkError(f"the servo process hangs: {why}")
            self._node.get_logger().error(self._hang.message)
            self._changed()
        client.suspend(self._hang)

    def _take_state(self, state: State, groups: dict[str, str], reason: str, lost: bool) -> None:
        """Take a change of state, from the listening thread."""
        self._changes.append((state, groups, reason, lost))
        self._node.wake()

    def _await_start(self) -> None:
        if self._starting is None or self._starting[1].done():
            return
        owner, promise = self._starting
        try:
            if owner.ready():
                promise.set_result(None)
        except Exception as error:  # whoever awaits it has to hear of it, whatever it is
            promise.set_exception(error)
