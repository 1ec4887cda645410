"""Fix the timers of the events executor: strike no timer early, and put none off by more than one period.

- Upstream: whenever a timer is made or reset, the events executor strikes each timer of the same clock once more that
  is due and not struck yet. Each such strike puts the timer off by another period: after a hundred resets in a late
  loop, a heartbeat is silent for a hundred periods.
- Issue: none of rclpy is known; https://github.com/ros2/rclcpp/issues/2771 has its sibling in C++.
- Seen: rclpy 7.1.6 (Jazzy).
- Test: ``test_rclpy_still_strikes_a_timer_once_for_each_reset`` in
  ``test/test_rclpy_fixes.py`` fails once upstream has mended it.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.timer import Timer


def punctual_timer(node: Node, make: Callable[[Callable[[], None]], Timer], callback: Callable[[], Any]) -> Timer:
    """Make a timer without strikes before the due time.

    Args:
        node: Node of the timer.
        make: Makes the timer of rclpy with the callback that is given.
        callback: Callback of the timer.
    """
    mending = False

    def put_off() -> bool:
        return not timer.is_canceled() and timer.time_until_next_call() > timer.timer_period_ns

    def strike() -> None:
        nonlocal mending
        try:
            early = put_off()
        except InvalidHandle:  # the timer was destroyed after it was due
            return
        if not early:
            callback()
        elif not mending:
            mending = True
            assert node.executor is not None, "the executor called this function"
            node.executor.create_task(mend)

    def mend() -> None:
        """Reset the timer once, after all waiting strikes: each reset makes rclpy look at all timers again."""
        nonlocal mending
        mending = False
        with suppress(InvalidHandle):
            if put_off():
                timer.reset()

    timer = make(strike)
    return timer
