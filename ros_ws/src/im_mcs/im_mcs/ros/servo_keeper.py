"""Looks after the servo process for the node: start, signs of life, end, and what changes there."""

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from im_core import clock
from im_core.errors import ImError, LinkError, StateError
from im_core.ros.coroutines import Promise
from im_mcs.client.servo_client import ServoClient
from im_mcs.ros.servo_owner import ServoOwner
from im_mcs.state import UNCONFIGURED_MESSAGE, State, lifecycle_of

if TYPE_CHECKING:
    from im_mcs.ros.node import McsNode

POLL_S = 0.02


class ServoKeeper:
    """The servo process in the life of the node.

    Args:
        node: The node.
        config_file: Configuration of the servo; None: that of the package.
        changed: Called in the node's loop after every change of state.
    """

    def __init__(self, node: "McsNode", config_file: Path | None, changed: Callable[[], None]) -> None:
        self._node = node
        self._reason = ""
        self._hang: LinkError | None = None
        self._config_file = config_file
        self._changed = changed
        self._owner: ServoOwner | None = None
        self._starting: tuple[ServoOwner, Promise] | None = None
        self._changes: deque[tuple[State, str]] = deque()

    @property
    def running(self) -> bool:
        """Whether there is a servo process to talk to."""
        return self._owner is not None

    @property
    def reason(self) -> str:
        """Why MCS is in its state, e.g. what caused an emergency stop; that the servo hangs, if it does; or empty."""
        return self._reason if self._hang is None else self._hang.message

    @property
    def state(self) -> State:
        """Present state of MCS."""
        return State.UNCONFIGURED if self._owner is None else self._owner.client.state()

    def client(self) -> ServoClient:
        """The way to the servo.

        Raises:
            StateError: MCS is unconfigured.
        """
        if self._owner is None:
            reason = f" ({self._reason})" if self._reason else ""
            raise StateError(UNCONFIGURED_MESSAGE + reason, state=State.UNCONFIGURED.value)
        return self._owner.client

    def start_blocking(self) -> None:
        """Start the servo process and wait until it holds the testbed.

        Raises:
            ImError: It cannot be started, or the testbed does not answer.
        """
        owner = self._new_owner()
        try:
            while not owner.ready():
                clock.sleep(POLL_S)
        except ImError:
            owner.close()
            raise
        self._owner = owner

    async def start(self) -> None:
        """As :meth:`start_blocking`, while the node goes on.

        Raises:
            ImError: It cannot be started, or the testbed does not answer.
        """
        owner = self._new_owner()
        self._starting = owner, self._node.promise()
        try:
            await self._starting[1]
        except ImError:
            owner.close()
            raise
        finally:
            self._starting = None
        self._owner = owner

    def close(self) -> None:
        """End the servo process; the testbed brakes by itself."""
        owner, self._owner, self._hang = self._owner, None, None
        if owner is not None:
            owner.close()

    def poll(self) -> None:
        """Look after everything; to be called every :data:`POLL_S` in the node's loop.

        The sign of life to the servo is given here, so that a node whose loop stands still is noticed.
        """
        self.follow()
        self._await_start()
        owner = self._owner
        if owner is None:
            return
        try:
            owner.process.check()
        except LinkError as error:
            self._reason = error.message
            self._node.get_logger().error(error.message)
            owner.client.give_up(error)
            self.close()
            self.follow()
            self._changed()
            return
        owner.client.beat()
        self._listen_to(owner.client)

    def follow(self) -> None:
        """Let the lifecycle and ``/mcs/state`` follow what has happened in the servo."""
        lifecycle = self._node.lifecycle
        wanted = lifecycle_of(self.state)
        if lifecycle.state == "active" and wanted != "active":
            lifecycle.follow("deactivate")
        if lifecycle.state == "inactive" and wanted == "unconfigured":
            lifecycle.follow("cleanup")
        while self._changes:
            state, self._reason = self._changes.popleft()
            text = f"MCS is {state.value}" + (f": {self._reason}" if self._reason else "")
            logger = self._node.get_logger()
            logger.warning(text) if self._reason else logger.info(text)
            self._changed()

    def _new_owner(self) -> ServoOwner:
        self._reason = ""
        return ServoOwner(self._node.config, self._config_file, self._take_state)

    def _listen_to(self, client: ServoClient) -> None:
        """Refuse requests while the servo process runs but gives no sign of life; nobody waits for it."""
        bound_s = self._node.config.safety.servo_silence_s
        if client.silence_s() <= bound_s:
            if self._hang is not None:
                self._hang = None
                client.resume()
                self._node.get_logger().warning("the servo process gives signs of life again")
                self._changed()
            return
        if self._hang is None:
            self._hang = LinkError(f"the servo process hangs: it has given no sign of life for {bound_s:g} s")
            self._node.get_logger().error(self._hang.message)
            self._changed()
        client.suspend(self._hang)

    def _take_state(self, state: State, reason: str) -> None:
        """A change of state, told by the thread that listens to the servo."""
        self._changes.append((state, reason))
        self._node.wake()

    def _await_start(self) -> None:
        if self._starting is None or self._starting[1].done():
            return
        owner, promise = self._starting
        try:
            if owner.ready():
                promise.set_result(None)
        except LinkError as error:
            promise.set_exception(error)
