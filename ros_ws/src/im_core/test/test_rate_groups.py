import signal
import time

import pytest

from im_core.errors import DataError, NotFoundError, StateError
from im_core.rate_groups import LATENESS_S, Overrun, RateGroups, RateLoop
from im_core.rate_groups import loop as loop_module
from im_core.rate_groups import pacer as pacer_module
from im_core.rate_groups.budget import Budget

PERIOD_S = 0.004


class Clock:
    """Wall time that passes when the test says so."""

    def __init__(self):
        self.now = 100.0

    def monotonic(self):
        return self.now

    def sleep_until(self, deadline):
        self.now = max(self.now, deadline)
        return self.now - deadline


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(pacer_module, "clock", made)
    monkeypatch.setattr(loop_module, "clock", made)
    monkeypatch.setattr("im_core.rate_groups.groups.clock", made)
    return made


def calls_of(groups, name, **how):
    """Register a function; the times of its calls, in base periods."""
    calls = []
    groups.register(name, lambda time_s: calls.append(round(time_s / groups.period_s, 9)), **how)
    return calls


def test_multiples_phases_and_divisors():
    groups = RateGroups(PERIOD_S)
    each, third, half = (
        calls_of(groups, "each"),
        calls_of(groups, "third", every=3, phase=2),
        calls_of(groups, "half", times=2),
    )
    RateLoop(groups, 0.0).run(iter([*[True] * 7, False]).__next__)
    assert each == [0, 1, 2, 3, 4, 5, 6]
    assert third == [2, 5]
    assert half == [k / 2 for k in range(14)]


def test_divisors_without_a_common_one_meet_at_the_begin_only():
    groups, order = RateGroups(PERIOD_S), []
    for name, times in (("thrice", 3), ("twice", 2), ("once", 1)):
        groups.register(name, lambda time_s, name=name: order.append((name, round(time_s / PERIOD_S * 6))), times=times)
    RateLoop(groups, 0.0).turn()
    assert order == [("thrice", 0), ("twice", 0), ("once", 0), ("thrice", 2), ("twice", 3), ("thrice", 4)]


def test_order_is_that_of_the_registration_whatever_the_rate():
    groups, order = RateGroups(PERIOD_S), []
    for name, every in (("slow", 4), ("quick", 1), ("middle", 2)):
        groups.register(name, lambda _, name=name: order.append(name), every=every)
    groups.run(0)
    assert order == ["slow", "quick", "middle"]
    groups.remove("slow")
    groups.run(4)
    assert order[3:] == ["quick", "middle"]


@pytest.mark.parametrize(
    ("overrun", "calls"), [(Overrun.SKIP, [0, 8]), (Overrun.LATE, [0, 2, 4, 6, 8]), (Overrun.STOP, [0])]
)
def test_missed_calls(overrun, calls):
    groups = RateGroups(PERIOD_S)
    made = calls_of(groups, "f", every=2, overrun=overrun)
    groups.run(0)
    groups.run(1)
    groups.run(8)  # 2, 4 and 6 were missed
    assert made == calls
    (told,) = groups.statistics()
    assert (told.missed, bool(told.ended)) == (3, overrun is Overrun.STOP)


def test_a_loop_that_missed_no_call_of_a_function_ends_nothing():
    groups = RateGroups(PERIOD_S)
    made = calls_of(groups, "f", every=10, overrun=Overrun.STOP)
    for tick in (0, 9, 10):
        groups.run(tick)
    assert made == [0, 10]


def test_a_long_absence_is_not_made_up_for_ever():
    groups = RateGroups(PERIOD_S)
    made = calls_of(groups, "f", overrun=Overrun.LATE)
    groups.run(0)
    groups.run(1_000_000)
    assert made[1:] == list(range(999_900, 1_000_001))
    assert groups.statistics()[0].missed == 999_999


def test_deadlines_of_parts_and_the_classes_of_lateness(clock):
    groups, begun = RateGroups(PERIOD_S), []
    groups.register("work", lambda _: setattr(clock, "now", clock.now + 0.0015))
    groups.register("twice", lambda _: begun.append(clock.now), times=2)
    loop = RateLoop(groups, PERIOD_S)
    loop.run(iter([True, True, False]).__next__)
    assert begun == pytest.approx([100.0015, 100.002, 100.0055, 100.006])
    work, twice = groups.statistics()
    assert work.lateness == [2] + [0] * len(LATENESS_S)
    late = LATENESS_S.index(2e-3)  # 1.5 ms behind the work
    assert (twice.lateness[0], twice.lateness[late]) == (2, 2)
    assert (work.share, work.longest_s) == pytest.approx((1.5 / 4, 1.5e-3))
    clock.now += 10.5 * PERIOD_S
    loop.pacer.wait()
    loop.turn()
    assert [told.missed for told in groups.statistics()] == [loop.pacer.missed, 2 * loop.pacer.missed]
    assert loop.pacer.missed == 9


def test_a_trusted_function_ends_the_loop_by_its_error():
    groups = RateGroups(PERIOD_S)
    groups.register("f", lambda _: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        groups.run(0)


def endless(_):
    while True:
        try:
            while True:
                pass
        except Exception:
            raise AssertionError from None


def test_functions_with_a_budget_end_and_the_others_go_on():
    groups = RateGroups(PERIOD_S)
    groups.register("endless", endless, budget_s=2e-3)
    groups.register("sleeps", lambda _: time.sleep(0.05), budget_s=2e-3)
    groups.register("fails", lambda _: 1 / 0, budget_s=60.0)
    groups.register("exits", lambda _: exit(3), budget_s=60.0)
    good, each = calls_of(groups, "good", budget_s=60.0), calls_of(groups, "each")
    before = signal.getsignal(signal.SIGALRM)
    for tick in range(3):
        groups.run(tick)
    assert signal.getsignal(signal.SIGALRM) is before
    assert (good, each) == ([0, 1, 2], [0, 1, 2])
    ended = {told.name: told.ended for told in groups.statistics()}
    assert ended["endless"].startswith("BudgetError: a call took ")
    assert ended["endless"].endswith(" ms, 2 ms are allowed")
    assert "BudgetError" in ended["sleeps"]
    assert ended["fails"] == "ZeroDivisionError: division by zero"
    assert ended["exits"] == "SystemExit: 3"
    assert not ended["good"]
    assert [told.calls for told in groups.statistics()] == [1, 1, 1, 1, 3, 3]


def test_an_ended_function_takes_no_parts():
    groups = RateGroups(PERIOD_S)
    groups.register("f", lambda _: 1 / 0, times=5, budget_s=1.0)
    assert groups.parts == 5
    groups.run(0)
    assert groups.parts == 1


@pytest.mark.parametrize(
    "how",
    [{"every": 0}, {"times": 0}, {"every": 2, "times": 2}, {"phase": 1}, {"every": 3, "phase": 3}, {"budget_s": 0.0}],
)
def test_wrong_rates_are_refused(how):
    groups = RateGroups(PERIOD_S)
    with pytest.raises(DataError, match="function 'f'"):
        groups.register("f", print, **how)
    assert groups.statistics() == ()


def test_names():
    groups = RateGroups(PERIOD_S)
    groups.register("f", print)
    with pytest.raises(DataError, match="registered already"):
        groups.register("f", print)
    with pytest.raises(NotFoundError, match="g"):
        groups.remove("g")
    with pytest.raises(DataError, match="base period"):
        RateGroups(0.0)


def test_an_alarm_that_comes_after_the_call_arms_no_other():
    """It would find the handler of before the call: none, which ends the process."""
    budget = Budget()
    budget.call(lambda time_s: None, 0.0, 1.0)
    before, _ = signal.getitimer(signal.ITIMER_REAL)  # of the tests, if any
    budget._on_alarm(signal.SIGALRM, None)
    after, _ = signal.getitimer(signal.ITIMER_REAL)
    assert 0.0 <= before - after < 600.0


def test_a_budget_needs_the_main_thread():
    from concurrent.futures import ThreadPoolExecutor

    groups = RateGroups(PERIOD_S)
    with ThreadPoolExecutor(1) as pool, pytest.raises(StateError, match="main thread"):
        pool.submit(groups.register, "f", print, budget_s=1.0).result()
