"""Work of a node's loop besides callbacks: coroutines, and delayed functions.

What waits costs nothing. The events executor looks at every suspended task of its own after every event: a thousand
actions that wait for something would take 8 ms of each second. Here a coroutine is looked at again only when the
promise is kept for which it waits.
"""

import heapq
import inspect
from collections import deque
from collections.abc import Callable, Coroutine, Generator
from dataclasses import dataclass
from typing import Any, Protocol

from rclpy.clock import Clock
from rclpy.task import Future
from rclpy.timer import Timer

from im_core import clock
from im_core.errors import FOREIGN, as_exception

Work = Coroutine[object, object, None]

#: A timer that strikes as soon as the loop is free [s]: who waits for it would lose a longer period each time.
SOON_S = 1e-6

#: An alarm waits for so long at least [s]. One that is set anew whenever it has struck, and is due again before the
#: loop has looked at anything else, is struck once more at each reset of another timer, without end.
_SHORTEST_S = 2e-4

_FEW = 64

_AT_ONCE = 32
"""So many coroutines go on before the loop looks at what else there is."""


class Promise(Future):
    """Future completable from any thread; the awaiting coroutine in the node's executor goes on.

    The events executor resumes suspended coroutines only after an event of the middleware. A promise makes one.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        Future.__init__(self)
        self._wake = wake

    def __await__(self) -> Generator["Promise", None, Any]:
        """Yield the promise to the runner of the coroutine."""
        while not self.done():
            yield self
        return self.result()

    def set_result(self, result: object) -> None:
        """Complete with a result."""
        Future.set_result(self, result)
        self._wake()

    def set_exception(self, exception: Exception) -> None:
        """Complete with an exception, raised where the promise is awaited."""
        Future.set_exception(self, exception)
        self._wake()


class OneAtATime:
    """Mutual exclusion of coroutines of a node: one at a time, the others wait in order of arrival."""

    def __init__(self, promise: Callable[[], Promise]) -> None:
        self._promise, self._taken = promise, False
        self._waiting: deque[Promise] = deque()

    async def __aenter__(self) -> None:
        """Wait for the turn of the coroutine."""
        if self._taken:
            turn = self._promise()
            self._waiting.append(turn)
            await turn
        self._taken = True

    async def __aexit__(self, *_: object) -> None:
        """Admit the next coroutine: no later arrival gets in before."""
        if self._waiting:
            self._waiting.popleft().set_result(None)
        else:
            self._taken = False


class Coroutines:
    """Runs coroutines in the loop of a node.

    Args:
        wake: Has :meth:`step` called in the loop, soon; from any thread.
        poll: Has the executor run a coroutine that waits for something other than a promise.
        failed: Is told what a coroutine raised.
    """

    def __init__(
        self, wake: Callable[[], None], poll: Callable[[Work], object], failed: Callable[[Exception], None]
    ) -> None:
        self._wake, self._poll, self._failed = wake, poll, failed
        self._ready: deque[Work] = deque()

    def spawn(self, work: Work) -> None:
        """Has a coroutine run; from any thread."""
        self._ready.append(work)
        self._wake()

    def begin(self, work: Work) -> None:
        """Run a coroutine until the first wait; in the loop."""
        self._run(work)

    def step(self) -> None:
        """Run all ready coroutines until each waits; call in the loop, which gets a turn after some coroutines."""
        for _ in range(_AT_ONCE):
            if not self._ready:
                return
            self._run(self._ready.popleft())
        self._wake()

    def close(self) -> None:
        """Drop all coroutines of an ending node; coroutines not yet begun never start."""
        while self._ready:
            work = self._ready.popleft()
            if inspect.getcoroutinestate(work) == inspect.CORO_CREATED:
                work.close()

    def _run(self, work: Work) -> None:
        try:
            awaited = work.send(None)
        except StopIteration:
            return
        except FOREIGN as error:  # foreign code must not stop the loop
            self._failed(as_exception(error))
            return
        if isinstance(awaited, Promise):
            awaited.add_done_callback(lambda _: self._ready.append(work))
        else:
            self._poll(_finish(work))


async def calling(work: Callable[[], None]) -> None:
    """Call a function: a spawn from any thread runs the call in the loop."""
    work()


async def _finish(work: Work) -> None:
    await _Rest(work)


class _Rest:
    """Rest of a coroutine already begun."""

    def __init__(self, work: Work) -> None:
        self._work = work

    def __await__(self) -> Generator[object, None, None]:
        while True:
            try:
                awaited = self._work.send(None)
            except StopIteration:
                return
            yield awaited


class TimedNode(Protocol):
    """Node as needed by alarms: with a timer of wall time."""

    steady_clock: Clock

    def create_timer(self, timer_period_sec: float, callback: Callable[[], None], *, clock: Clock) -> Timer:
        """As in rclpy."""
        ...


@dataclass(eq=False)
class Alarm:
    """Function to be called once; None after the call or the cancellation."""

    call: Callable[[], None] | None


class Alarms:
    """Call functions in a node's loop at wall times: any number of functions, with one timer of the middleware."""

    def __init__(self, node: TimedNode) -> None:
        self._heap: list[tuple[float, int, Alarm]] = []
        self._count = 0
        self._cancelled = 0
        self._timer = node.create_timer(1.0, self._strike, clock=node.steady_clock)
        self._timer.cancel()

    def after(self, seconds: float, call: Callable[[], None]) -> Alarm:
        """Has a function called after a time [s]; from the loop."""
        alarm = Alarm(call)
        self._count += 1
        heapq.heappush(self._heap, (clock.monotonic() + seconds, self._count, alarm))
        if self._heap[0][2] is alarm:
            self._set()
        return alarm

    def cancel(self, alarm: Alarm) -> None:
        """Cancel an alarm, if the function was not called yet."""
        if alarm.call is None:
            return
        alarm.call = None
        self._cancelled += 1
        if self._cancelled > _FEW and 2 * self._cancelled > len(self._heap):
            self._heap = [entry for entry in self._heap if entry[2].call is not None]
            heapq.heapify(self._heap)
            self._cancelled = 0

    def _strike(self) -> None:
        self._timer.cancel()
        now = clock.monotonic()
        try:
            while self._heap and self._heap[0][0] <= now:
                alarm = heapq.heappop(self._heap)[2]
                call, alarm.call = alarm.call, None
                if call is None:
                    self._cancelled -= 1
                else:
                    call()
        finally:  # one that raises does not hold up the others
            self._set()

    def _set(self) -> None:
        if self._heap:
            left = max(_SHORTEST_S, self._heap[0][0] - clock.monotonic())
            self._timer.timer_period_ns = round(1e9 * left)
            self._timer.reset()
