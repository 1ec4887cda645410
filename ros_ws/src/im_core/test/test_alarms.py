"""Functions called after a time, without ROS."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core import clock
from im_core.ros.coroutines import Alarm, Alarms


class FakeTimer:
    """A periodic timer that strikes when the test's time has come."""

    def __init__(self, call: Callable[[], None]) -> None:
        self.call = call
        self.timer_period_ns = 0
        self.due: float | None = None

    def reset(self) -> None:
        self.due = NOW[0] + 1e-9 * self.timer_period_ns

    def cancel(self) -> None:
        self.due = None


NOW = [0.0]


class FakeNode:
    steady_clock = None

    def create_timer(self, period_s: float, call: Callable[[], None], clock: object) -> FakeTimer:
        self.timer = FakeTimer(call)
        return self.timer

    def run_until(self, end: float) -> None:
        while self.timer.due is not None and self.timer.due <= end:
            NOW[0] = max(NOW[0], self.timer.due)
            self.timer.call()
        NOW[0] = end


@pytest.fixture(autouse=True)
def test_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "monotonic", lambda: NOW[0])


@given(st.lists(st.tuples(st.floats(0.0, 10.0), st.booleans()), max_size=200))
def test_each_is_called_once_in_order_and_not_before_its_time_unless_taken_back(
    wanted: list[tuple[float, bool]],
) -> None:
    NOW[0] = 0.0
    node = FakeNode()
    alarms = Alarms(node)
    called: list[tuple[float, float]] = []
    made: list[tuple[Alarm, bool]] = []
    for seconds, taken_back in wanted:
        made.append((alarms.after(seconds, lambda s=seconds: called.append((s, NOW[0]))), taken_back))
    for alarm, taken_back in made:
        if taken_back:
            alarms.cancel(alarm)
    node.run_until(11.0)
    assert [seconds for seconds, _ in called] == sorted(seconds for seconds, taken_back in wanted if not taken_back)
    assert all(at >= seconds for seconds, at in called)
    assert node.timer.due is None


def test_one_that_is_made_by_another_is_called_too() -> None:
    NOW[0] = 0.0
    node = FakeNode()
    alarms = Alarms(node)
    called: list[float] = []
    alarms.after(1.0, lambda: alarms.after(1.0, lambda: called.append(NOW[0])))
    node.run_until(3.0)
    assert called == [pytest.approx(2.0)]
