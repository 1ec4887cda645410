"""Errors raised in callbacks of a node: logged, and counted on ``/diagnostics``."""

import traceback
from collections.abc import Callable, Sequence

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from im_core import clock
from im_core.errors import ImError
from im_core.ros import qos

#: What fails again and again is said so often [s]; the counts are published so often, from the first failure on [s].
REPEAT_S = 10.0
DIAGNOSTICS_PERIOD_S = 1.0
#: Nodes that are named as those who may have sent something.
MOST_NAMES = 5


class Failures:
    """Counter of unexpected exceptions.

    Args:
        node: Whose callbacks they are; it may not be made yet.

    Attributes:
        counts: How often each callback has failed, by what it serves, as in ``subscription /pnt/nets``.
        last: The sentence of the last failure; empty before the first.
    """

    def __init__(self, node: Node) -> None:
        self.counts: dict[str, int] = {}
        self.last = ""
        self._node = node
        self._said: dict[str, tuple[float, int]] = {}
        self._publisher: Publisher | None = None

    def add(self, what: str, error: BaseException, told: Callable[[], str] = str) -> None:
        """Note a failure.

        Args:
            what: Kind of callback and name of what it serves, e.g. ``service /dom/put``.
            error: What was raised.
            told: Says the type of what came, and who sent it, as far as that is known. It looks through the graph, and
                is asked only when the failure is said: whoever floods a node costs it no more than the call.
        """
        count = self.counts[what] = self.counts.get(what, 0) + 1
        said_at, said = self._said.get(what, (-REPEAT_S, 0))
        now = clock.monotonic()
        due = now - said_at >= REPEAT_S
        detail = told() if due else ""
        self.last = f"{what}{f' ({detail})' if detail else ''}: {sentence(error)}"
        if due:
            self._said[what] = now, count
            expected = said or isinstance(error, ImError)  # which says what is wrong; of others it matters where
            words = self.last if expected else f"{self.last}\n{_trace(error)}"
            again = f" (failed {count - said} times since this was said last)" if said else ""
            self._node.get_logger().error(f"the callback of {words}{again}")
        self._show()

    def _show(self) -> None:
        """Begin to publish."""
        if self._publisher is None and self._node.context.ok():
            self._publisher = self._node.create_publisher(DiagnosticArray, "/diagnostics", qos.STATUS)
            steady = Clock(clock_type=ClockType.STEADY_TIME)
            self._node.create_timer(DIAGNOSTICS_PERIOD_S, self._publish, clock=steady)

    def _publish(self) -> None:
        assert self._publisher is not None, "the timer is made with it"
        message = DiagnosticArray(status=[self.status()])
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)

    def status(self) -> DiagnosticStatus:
        """The counts as a message."""
        values = [KeyValue(key=what, value=str(count)) for what, count in sorted(self.counts.items())]
        name, times = self._node.get_name(), sum(self.counts.values())
        words = f"callbacks failed {times} times, last: {self.last}" if times else "no callback has failed"
        level = DiagnosticStatus.WARN if times else DiagnosticStatus.OK
        return DiagnosticStatus(level=level, name=f"{name}: callbacks", hardware_id=name, message=words, values=values)


def sentence(error: BaseException) -> str:
    """Return the sentence of an error, as a text fit for every message: half a pair of surrogates has no UTF-8."""
    words = error.message if isinstance(error, ImError) else f"{type(error).__name__}: {error}"
    return words.encode("utf-8", "backslashreplace").decode()


def few(names: Sequence[str]) -> str:
    """The first names of many, and how many more there are."""
    more = len(names) - MOST_NAMES
    return ", ".join(names[:MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def _trace(error: BaseException) -> str:
    try:
        lines = traceback.format_exception(error)
    except SystemError:  # Python 3.11 cannot parse in two threads at once (gh-106905), and parses for its carets
        frames = traceback.walk_tb(error.__traceback__)
        lines = [f'  File "{frame.f_code.co_filename}", line {line}\n' for frame, line in frames]
    return "".join(lines).rstrip().encode("utf-8", "backslashreplace").decode()
