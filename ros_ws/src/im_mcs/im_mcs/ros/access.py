"""Common tools of the node's servers: the configuration in force, the groups, and the way to the servo."""

import re
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.impl.rcutils_logger import RcutilsLogger

from im_cell.robot import Group, load_cell
from im_core import clock, names
from im_core.errors import ImError, StateError
from im_core.ros.calls import pause, run_in_thread
from im_core.ros.coroutines import Promise
from im_core.ros.node import ManagedNode
from im_core.ros.peers.client_identity import nodes_of
from im_mcs.client.evidence import EvidenceLimit, write_evidence
from im_mcs.client.groups import all_groups, group_in_force
from im_mcs.client.kinematics import Kinematics
from im_mcs.client.servo_client import OnProgress, ServoClient, ServoReply
from im_mcs.collision import NOTHING, CollisionScene
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import CellModel
from im_mcs.protocol.evidence import KEPT
from im_mcs.ros.bounds import check_bounds
from im_mcs.ros.lifecycle import Lifecycle
from im_mcs.ros.servo_keeper import FINALIZED_MESSAGE, POLL_S, ServoKeeper
from im_mcs.safety.stop_circuits import StopCircuits
from im_mcs.state import POWERED, Event, State, next_state

Started = Callable[[int], None]
"""Told the number of a request that has been sent."""

_EVIDENCE = "mcs"
_NUMBER = re.compile(r"(?<![\w.])-?\d[\d.]*(?:e[-+]?\d+)?")
_INTRODUCTIONS, _INTRODUCTION_S = 20, 0.05
#: How long a testbed that was lost is waited for, and how often it is looked for [s] of wall time.
_RECOVERY_S, _AGAIN_S = 20.0, 0.5  # less than the 30 s for which nets wait for an answer
#: Time for the answer of a last service to leave [s].
_ANSWERED_S = 0.5


class Refusals:
    """Counter of refused messages by topic; a sentence is logged once for any numbers inside; thread-safe."""

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._last: dict[str, str] = {}

    def add(self, topic: str, error: ImError) -> None:
        """Note a refused message on ``topic``, or a bad end of the request."""
        sentence = _NUMBER.sub("#", error.message)
        with self._lock:
            self._counts[topic] += 1
            told = self._last.get(topic) == sentence
            self._last[topic] = sentence
        if not told:
            self._logger.warning(f"{topic}: {error.message}")

    def counts(self) -> dict[str, int]:
        """Number of refused messages by topic."""
        with self._lock:
            return dict(self._counts)


class TakeOvers:
    """Takeovers of groups from the owners: in the log, and on ``/diagnostics``."""

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._newest: dict[str, str] = {}

    def add(self, group: str, before: str, owner: str, by: Sequence[str]) -> str:
        """Note a takeover: group, owners before and now, operator, by name; return the note as a sentence."""
        was, now = (f"'{name}'" if name else "anyone" for name in (before, owner))
        sentence = f"group '{group}', until now of {was}, is taken over for {now} by {', '.join(by)}"
        self._newest[group] = sentence
        self._logger.warning(sentence)
        return sentence

    def newest(self) -> dict[str, str]:
        """The newest one of each group, as a sentence."""
        return dict(self._newest)


class McsAccess:
    """MCS in the eyes of the node's servers.

    Attributes:
        node: The node that offers them.
        config: Configuration, with the preset in force.
        cell: Parameters of the cell.
        model: Its kinematics, for the node's thread.
        kinematics: Kinematic questions, for any thread.
        lifecycle: Of the node; its transitions go through the servo.
        keeper: Looks after the servo process.
        refusals: Messages on topics that were refused: nobody waits there for an answer.
        take_overs: Groups that were taken away from their owners.

    Args:
        node: The node.
        config: Configuration.
        config_file: Where it came from; None: the one of the package.
        changed: Called in the node's loop after every change of state.
    """

    def __init__(
        self, node: ManagedNode, config: McsConfig, config_file: Path | None, changed: Callable[[], None]
    ) -> None:
        self.node, self.config = node, config
        self.cell = load_cell()
        self.model = CellModel(self.cell)
        self.kinematics = Kinematics(config, CellModel(self.cell))
        self._around = NOTHING
        self.refusals = Refusals(node.get_logger())
        self.take_overs = TakeOvers(node.get_logger())
        self._changed, self._shown_tick = changed, -1
        self._evidence: dict[tuple[ServoClient, int, str], Promise] = {}
        self._evidence_limit = EvidenceLimit()
        self.lifecycle = Lifecycle(
            node,
            {
                "configure": self._configure,
                "cleanup": self._cleanup,
                "activate": lambda client: self._power(Event.POWER_ON, client),
                "deactivate": lambda client: self._power(Event.POWER_OFF, client),
                "shutdown": self._shutdown,
            },
        )
        circuits = StopCircuits(config.testbed.drivers, names.instance())
        silence_s = config.safety.servo_silence_s
        self.keeper = ServoKeeper(node, self.lifecycle, config_file, silence_s, circuits, changed)

    @property
    def state(self) -> State:
        """Present state of MCS."""
        return self.keeper.state

    @property
    def group_names(self) -> list[str]:
        """Groups of all presets; each has the servers and topics under any preset in force."""
        return all_groups(self.config)

    def client(self) -> ServoClient:
        """The way to the servo.

        Raises:
            StateError: MCS is unconfigured.
        """
        return self.keeper.client()

    def group(self, name: str) -> Group:
        """Return a group of the preset in force.

        Raises:
            StateError: MCS is unconfigured, or the group is one of another preset.
            NotFoundError: No preset has such a group.
        """
        self.client()
        return group_in_force(self.config, name)

    def check(self, message: Any) -> None:
        """Check the size of a client's message, before any work with the message.

        Raises:
            DataError: A text or a list is too long, or a number is not finite or too large.
        """
        check_bounds(message, self.config.planning.max_points)

    def index(self, group: Group) -> NDArray[np.intp]:
        """Return ranks of a group's joints among all, shape (n,)."""
        return np.array([self.model.index(joint) for joint in group.joints], dtype=np.intp)

    def lead_joints(self, group: str) -> list[str]:
        """Return the joints below the first wrist of a pair, in the order of the group; [] of any other group."""
        described = self.group(group)
        if not described.pair:
            return []
        below = self.model.joints_below(described.pair[0])
        return [joint for joint in described.joints if self.model.index(joint) in below]

    async def sender(self, client: str, *names: str) -> dict[str, Any]:
        """Return the sender, in the form of the arguments of a request.

        A process that has just begun is given a moment to be known by name.

        Args:
            client: As :func:`im_core.ros.peers.client_identity.client_of` says; empty: not known.
            *names: Owners that the request names; empty ones do not count.
        """
        nodes = nodes_of(self.node, client) if client else ()
        for _ in range(_INTRODUCTIONS if client else 0):
            if nodes:
                break
            await pause(self.node, _INTRODUCTION_S)
            nodes = nodes_of(self.node, client)
        return {"client": client, "names": [*filter(None, names), *nodes]}

    async def request(
        self,
        event: Event,
        arguments: dict[str, Any] | None = None,
        started: Started | None = None,
        on_progress: OnProgress | None = None,
    ) -> dict[str, Any]:
        """Ask the servo and await the answer.

        Args:
            event: What is asked for.
            arguments: What the event needs.
            started: Told the number of the request.
            on_progress: Told how far it is, in another thread.

        Raises:
            ImError: The servo refuses, or what was asked for ended badly; where there is a record of the last two
                seconds, the message names its file.
        """
        promise = self.node.promise()
        client = self.client()
        number = client.send(event, arguments, promise.set_result, on_progress)
        if started is not None:
            started(number)
        reply = await promise
        assert isinstance(reply, ServoReply)
        self.keeper.follow()
        if (tick := int(client.snapshot()["tick"])) != self._shown_tick:  # answers of one tick tell of one state
            self._shown_tick = tick
            self._changed()
        if reply.error is not None:
            raise await self._with_evidence(client, self.keeper.explain(reply.error), reply.results)
        return reply.results

    async def transition(self, event: Event, client: str, group: str = "", owner: str = "") -> str:
        """Change power or motion; return the new state, as a sentence. The lifecycle follows.

        Args:
            event: ``power_on``, ``power_off``, ``enable_motion`` or ``disable_motion``.
            client: Who asks.
            group: Which group; empty: all that are the client's and in the state from which it leads.
            owner: Whose they are, as the request says; empty: it does not say.

        Raises:
            ImError: It is refused, or ended badly.
        """
        self.client()
        if group:
            self.group(group)
        await self.request(event, {"group": group, "sender": await self.sender(client, owner)})
        return f"MCS is {self.state.value}"

    async def stop(self, event: Event) -> str:
        """Stop by ``protective_stop``, or ``reset`` an emergency stop; return the resulting state as a sentence.

        Raises:
            ImError: It is refused, or ended badly.
        """
        if event is Event.RESET:
            await self.keeper.reset(self.request)
            return f"MCS is {self.state.value}"
        await self.request(event, {"reason": f"request on /mcs/{event.value}"})
        return f"MCS is {self.state.value}"

    async def recover(self) -> None:
        """Bring MCS back to cold after the loss of the servo or testbed; wait for both. Nothing moves.

        An emergency stop that has any other cause stays latched. What somebody else has begun, to bring it back, is
        waited for.

        Raises:
            ImError: The servo cannot be started, or the testbed is not back in time; the last reason.
        """
        deadline = clock.monotonic() + _RECOVERY_S
        while self.keeper.recovering or self.keeper.lost:
            if self.keeper.recovering:
                if clock.monotonic() > deadline:
                    return  # what is asked for next says how it stands
                await pause(self.node, POLL_S)
                continue
            try:
                if self.keeper.stop_cause:
                    await self.stop(Event.RESET)
                else:
                    await self.lifecycle.change("configure")
            except ImError:
                if clock.monotonic() > deadline:
                    raise
                await pause(self.node, _AGAIN_S)

    async def repartition(self, preset: str, client: str) -> None:
        """Divide the joints into groups anew, for a client.

        Raises:
            ImError: There is no such preset, or the state does not allow it.
        """
        config = self.config.with_preset(preset)
        await self.request(Event.REPARTITION, {"preset": preset, "sender": await self.sender(client)})
        self.config = config
        kinematics = Kinematics(config, CellModel(self.cell))
        kinematics.surround(self._around)
        self.kinematics = kinematics
        self._changed()

    def around(self, stamp_ns: int) -> CollisionScene:
        """Return the free bodies and the contacts allowed at a testbed time [ns]; paths are checked for these."""
        if (around := self._around.at(stamp_ns)) is not self._around:
            self._around = around
            self.kinematics.surround(around)
        return self._around

    async def surround(self, around: CollisionScene) -> None:
        """Watch other free bodies and contacts, in the servo and in the checks of paths.

        Raises:
            ImError: The servo refuses.
        """
        before, self._around = self._around, around  # now: what another asks for meanwhile is added to it
        try:
            await self._tell_servo(around)
        except ImError:
            if self._around is around:
                self._around = before
            raise
        self.kinematics.surround(self._around)

    async def _tell_servo(self, around: CollisionScene) -> None:
        arguments = {
            "things": [thing.model_dump() for thing in around.things],
            "contacts": [contact.model_dump() for contact in around.contacts],
        }
        await self.request(Event.SURROUND, arguments)

    async def _power(self, event: Event, client: str) -> None:
        """Switch the power of all groups of the client: lifecycle *active* is power on, of any owner."""
        next_state(self.state, event, cause=self.keeper.stop_cause)
        await self.transition(event, client)
        if event is Event.POWER_OFF and self.state in POWERED:
            raise StateError("power stays on: a group of another client needs it", state=self.state.value)

    async def _configure(self, _: str) -> None:
        next_state(self.state, Event.CONFIGURE)
        if cause := self.keeper.stop_cause:
            raise StateError(f"configure is refused: an emergency stop is latched ({cause}); reset it (/mcs/reset)")
        await self.keeper.start(self.config)
        if self._around != NOTHING:  # what lies around outlives the servo
            await self._tell_servo(self._around)
        self._changed()

    async def _cleanup(self, _: str) -> None:
        next_state(self.state, Event.CLEANUP)
        self.keeper.close()

    async def _shutdown(self, _: str) -> None:
        """End the servo; from *finalized* no transition leads back, so the task asks for a new start."""
        self.keeper.close()
        self.node.alarms.after(_ANSWERED_S, lambda: self.node.fail(StateError(FINALIZED_MESSAGE)))

    async def _with_evidence(self, client: ServoClient, error: ImError, results: dict[str, Any]) -> ImError:
        """Write the evidence of an error, if any, and name the file in message and facts.

        Goals that end in one tick for one reason share the evidence: it is written once. Of many errors of a kind soon
        after each other, some have none.
        """
        key = client, int(results.get("evidence", 0)), error.message
        written = self._evidence.get(key)
        if written is None:
            record = client.evidence(key[1])
            if record is None or not self._evidence_limit.allows(error.code, clock.monotonic()):
                return error
            written = self._evidence[key] = self.node.promise()
            if len(self._evidence) > KEPT:
                del self._evidence[next(iter(self._evidence))]
            self.node.spawn(self._write_evidence(record, error, written))
        path = await written
        if not path:
            return error
        facts = {**error.facts, "evidence": path}
        return ImError.restored(error.code, f"{error.message}; the last seconds are in {path}", facts)

    async def _write_evidence(self, record: dict[str, Any], error: ImError, written: Promise) -> None:
        """Write the evidence of an error in a thread; the path, or an empty text, is the result of a promise."""
        path = ""
        try:
            folder, joints = names.results_dir() / _EVIDENCE, tuple(self.model.names)
            path = str(await run_in_thread(self.node, write_evidence, folder, record, error, joints))
        except ImError as trouble:
            self.node.get_logger().warning(trouble.message)
        finally:
            written.set_result(path)
