"""The loop of a node's nets: takes arrived events, fires, writes the journal, and then lets effects leave."""

import contextlib
import threading
from collections.abc import Callable, Mapping

from rclpy.exceptions import InvalidHandle

from im_core.clock import monotonic
from im_core.ros.calls import pause
from im_core.ros.coroutines import SOON_S, Alarm
from im_core.ros.node import ManagedNode
from im_pnt.errors import JournalError
from im_pnt.execution.events import PauseSet
from im_pnt.execution.executor import Executor
from im_pnt_node.journal.journal import Journal

RETRY_AFTER_S = 1.0
WRITTEN_S = 0.1
"""How often it is looked whether a journal that could not be written is [s]."""
MOST_AT_A_STRETCH = 120_000
"""Firings after which a net that does not come to rest is paused: it would leave no time for anybody else."""


class NetLoop:
    """Loop of nets in the thread of the node's executor.

    Nothing is polled: a turn follows what arrives, and one alarm waits for the next deadline or delay of all nets.

    Args:
        node: The node.
        nets: Its nets by name; looked at anew at each turn.
        may_turn: Whether the nets may fire now.
        flush: Lets messages leave.
        told: Called after a turn, when what is urgent has been done.

    Attributes:
        journal: Is written before messages leave; None: none is kept.
    """

    def __init__(
        self,
        node: ManagedNode,
        nets: Mapping[str, Executor],
        may_turn: Callable[[], bool],
        flush: Callable[[], None],
        told: Callable[[], None],
    ) -> None:
        self._node, self._nets, self._may_turn, self._flush, self._told = node, nets, may_turn, flush, told
        self.journal: Journal | None = None
        self._thread: int | None = None
        self._turning = self._wakened = False
        self._wake_timer = node.create_timer(SOON_S, self._woken, clock=node.steady_clock)
        self._wake_timer.cancel()
        self._alarm: Alarm | None = None
        self._alarm_at: float | None = None

    def wake(self) -> None:
        """Has a turn taken soon; from any thread."""
        if not self._turning or threading.get_ident() != self._thread:
            self._wakened = True
            with contextlib.suppress(InvalidHandle):  # an action may end when its node is gone
                self._wake_timer.reset()

    def pump(self, executor: Executor) -> bool:
        """Pump a net, and pause the net if firing on and on without rest; in the loop.

        Returns:
            Whether there is more to do at once.
        """
        more = executor.pump()
        if more and not executor.operator.paused and executor.stretch >= MOST_AT_A_STRETCH:
            executor.post(PauseSet(True))
            self._node.get_logger().error(
                f"net {executor.net.name} has fired {executor.stretch} times without coming to rest, waits for nothing "
                "and is paused; 'resume' of its control_net lets it go on as far again"
            )
        return more

    def turn(self) -> None:
        """Take arrived events and fire until nothing is enabled; in the loop."""
        self._turn(everyone=False)

    def take_packet(self, hear: Callable[[str], None], text: str) -> None:
        """Has a packet for the nets heard, and then takes a turn; in the loop."""
        self._thread = threading.get_ident()
        self._turning = True  # nobody need be woken for what is posted now
        try:
            hear(text)
        finally:
            self._turning = False
        self._turn(everyone=False)

    async def written(self, longest_s: float) -> None:
        """Wait until all that was posted is taken, and in the journal.

        Args:
            longest_s: Longest wait for a journal that cannot be written [s].

        Raises:
            JournalError: It cannot be written.
        """
        while not self._may_turn():
            await pause(self._node, WRITTEN_S)
        self.turn()
        deadline = monotonic() + longest_s
        while self.journal is not None and self.journal.unwritten:  # the loop tries again
            if monotonic() >= deadline:
                self.journal.write()
            await pause(self._node, WRITTEN_S)

    def _woken(self) -> None:
        self._wake_timer.cancel()
        self._wakened = False
        self.turn()

    def _strike(self) -> None:
        self._alarm_at = None
        self._turn(everyone=True)

    def _turn(self, *, everyone: bool) -> None:
        if self._turning or not self._may_turn():
            return
        self._thread = threading.get_ident()
        self._turning = True
        try:
            for executor in tuple(self._nets.values()):
                if everyone or executor.due:
                    self.pump(executor)
            if self.journal is not None:
                self.journal.commit()
            self._flush()
        except Exception as error:
            self._set_alarm(monotonic() + RETRY_AFTER_S)
            if not isinstance(error, JournalError):
                raise
            self._node.get_logger().error(f"{error.message}; nothing leaves until it can be written")
            return
        finally:
            self._turning = False
        at: float | None = None
        for executor in self._nets.values():
            time = executor.next_wakeup()
            if executor.due and executor.stretch:
                time = monotonic()  # an alarm lets others have a turn before
            elif executor.due and not self._wakened:
                self.wake()
            if time is not None and (at is None or time < at):
                at = time
        self._set_alarm(at)
        self._told()

    def _set_alarm(self, at: float | None) -> None:
        if at == self._alarm_at:
            return
        if self._alarm is not None:
            self._node.alarms.cancel(self._alarm)
        self._alarm_at = at
        self._alarm = None if at is None else self._node.alarms.after(at - monotonic(), self._strike)
