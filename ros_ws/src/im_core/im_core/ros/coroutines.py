"""Coroutines of a node that cost nothing while they wait.

The events executor looks at every suspended task of its own after every event: a thousand actions that wait for
something would take 8 ms of each second. Here a coroutine is looked at again only when the promise is kept for which
it waits.
"""

from collections import deque
from collections.abc import Callable, Coroutine, Generator

from rclpy.task import Future

Work = Coroutine[object, object, None]


class Promise(Future):
    """A future that may be completed from any thread; whoever awaits it in the node's executor goes on.

    The events executor resumes suspended coroutines only after an event of the middleware. A promise makes one.

    Args:
        wake: Makes an event, soon.
    """

    def __init__(self, wake: Callable[[], None]) -> None:
        super().__init__()
        self._wake = wake

    def __await__(self) -> Generator["Promise", None, object]:
        """Tells whoever runs the coroutine what it waits for."""
        while not self.done():
            yield self
        return self.result()

    def set_result(self, result: object) -> None:
        """Complete with a result."""
        super().set_result(result)
        self._wake()

    def set_exception(self, exception: Exception) -> None:
        """Complete with an exception, raised where the promise is awaited."""
        super().set_exception(exception)
        self._wake()


class Coroutines:
    """Runs coroutines in the loop of a node.

    Args:
        wake: Has :meth:`step` called in the loop, soon; from any thread.
        poll: Has the executor run a coroutine that waits for something other than a promise.
        failed: Is told what a coroutine raised.
    """

    def __init__(
        self, wake: Callable[[], None], poll: Callable[[Work], None], failed: Callable[[Exception], None]
    ) -> None:
        self._wake, self._poll, self._failed = wake, poll, failed
        self._ready: deque[Work] = deque()

    def spawn(self, work: Work) -> None:
        """Has a coroutine run; from any thread."""
        self._ready.append(work)
        self._wake()

    def step(self) -> None:
        """Runs every coroutine that can go on until it waits; in the loop."""
        while self._ready:
            self._run(self._ready.popleft())

    def _run(self, work: Work) -> None:
        try:
            awaited = work.send(None)
        except StopIteration:
            return
        except Exception as error:  # foreign code must not stop the loop
            self._failed(error)
            return
        if isinstance(awaited, Promise):
            awaited.add_done_callback(lambda _: self._ready.append(work))
        else:
            self._poll(_finish(work))


async def _finish(work: Work) -> None:
    await _Rest(work)


class _Rest:
    """What is left of a coroutine that has begun."""

    def __init__(self, work: Work) -> None:
        self._work = work

    def __await__(self) -> Generator[object, None, None]:
        while True:
            try:
                awaited = self._work.send(None)
            except StopIteration:
                return
            yield awaited
