import pytest

from im_core import clock
from im_mcs.servo.realtime import Pacer


def test_absolute_deadlines_do_not_drift():
    pacer = Pacer(0.004)
    began = clock.monotonic()
    for k in range(60):
        pacer.wait()
        if k % 10 == 5:
            clock.sleep(0.002)  # work
    elapsed = clock.monotonic() - began
    assert elapsed == pytest.approx(59 * 0.004, abs=0.02)
    assert pacer.mean_period_s == pytest.approx(0.004, rel=0.1)


def test_missed_deadlines_are_counted_and_skipped():
    pacer = Pacer(0.004)
    pacer.wait()
    clock.sleep(0.004 * 5.5)
    pacer.wait()
    assert pacer.missed >= 4
    assert pacer.missed_in_row == pacer.missed
    pacer.wait()
    assert pacer.missed_in_row == 0
    pacer.restart()
    assert (pacer.ticks, pacer.missed) == (0, 0)


def test_without_a_period_it_does_not_sleep():
    pacer = Pacer(0.0)
    began = clock.monotonic()
    for _ in range(1000):
        pacer.wait()
    assert clock.monotonic() - began < 0.5
    assert pacer.mean_period_s == 0.0
