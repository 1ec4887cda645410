import pytest

from im_core.rate_groups import pacer as pacer_module
from im_core.rate_groups.pacer import Pacer


class Clock:
    """Wall time that passes when the test says so; whoever sleeps wakes a little late."""

    LATE_S = 1e-4

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds

    def sleep_until(self, deadline):
        self.now = max(self.now, deadline) + self.LATE_S
        return self.now - deadline


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(pacer_module, "clock", made)
    return made


def test_absolute_deadlines_do_not_drift(clock):
    pacer = Pacer(0.004)
    began = clock.monotonic()
    for k in range(60):
        pacer.wait()
        if k % 10 == 5:
            clock.sleep(0.002)  # work
    assert clock.monotonic() - began == pytest.approx(59 * 0.004 + clock.LATE_S)
    assert pacer.mean_period_s == pytest.approx(0.004)
    assert pacer.max_lateness_s == pytest.approx(clock.LATE_S)
    assert pacer.missed == 0


def test_missed_deadlines_are_counted_and_skipped(clock):
    pacer = Pacer(0.004)
    pacer.wait()
    clock.sleep(0.004 * 5.5)
    pacer.wait()
    assert pacer.missed == 4  # and the fifth was met, late
    assert pacer.missed_in_row == pacer.missed
    pacer.wait()
    assert pacer.missed_in_row == 0
    pacer.restart()
    assert (pacer.ticks, pacer.missed) == (0, 0)


def test_without_a_period_it_does_not_sleep(clock):
    pacer = Pacer(0.0)
    for _ in range(1000):
        pacer.wait()
    assert clock.monotonic() == 100.0
    assert pacer.mean_period_s == 0.0
