"""Starts and ends of firings out of a bag: whose they are where a net begins anew, or the recording came late."""

from types import SimpleNamespace

import pytest

from im_pnt.netfile import parse_net
from im_pnt_analysis.cli.fit import measured
from im_pnt_analysis.recorded.firings import mission_from
from im_pnt_analysis.timed.measurement import MeasuredFiring, estimate

START, END, FAILED, CANCEL = range(4)
NET = parse_net("""
net: n
places: {a: 1, b: , bad: }
transitions: {work: {in: a, out: b, action: act, on_failure: [bad], success: 0.97}}
""")


def told(sequence: int, stamp_s: float, phase: int, duration: float = 0.0) -> SimpleNamespace:
    stamp = SimpleNamespace(sec=int(stamp_s), nanosec=int(stamp_s % 1.0 * 1e9))
    said = {"symbol": "", "message": "", "command_id": 1, "progress": -1.0}
    return SimpleNamespace(
        stamp=stamp, net="n", transition="work", sequence=sequence, phase=phase, duration=duration, **said
    )


def durations(*events: SimpleNamespace) -> list[float]:
    return [each.duration for each in measured(mission_from(events, {"n": NET}))]


def test_the_start_of_a_life_that_ended_is_not_joined_with_an_end_of_the_next_one() -> None:
    first = [told(1, 1.0, START), told(2, 3.0, END, 2.0), told(3, 10.0, START)]
    anew = [told(1, 1.0, START), told(2, 3.0, END, 2.0), told(3, 10.0, START), told(4, 12.0, END, 2.0)]
    assert durations(*first, *anew) == pytest.approx([2.0, 2.0, 2.0])
    mission = mission_from([*first, *anew], {"n": NET})
    assert [firing.end_s is None for firing in mission.firings] == [False, True, False, False]


def test_what_began_before_the_recording_has_no_duration() -> None:
    events = [told(7, 5.0, END, 2.0), told(8, 6.0, START), told(9, 8.0, END, 2.0)]
    assert durations(*events) == pytest.approx([2.0])
    (times,) = mission_from(events, {"n": NET}).actions()
    assert (times.count, times.mean_s) == (1, pytest.approx(2.0))


def test_what_was_cut_short_tells_nothing_of_how_long_it_takes_or_how_often_it_succeeds() -> None:
    events = [told(1, 1.0, START), told(2, 2.0, CANCEL), told(3, 2.5, FAILED, 1.5)]
    assert durations(*events) == []


@pytest.mark.parametrize(("failures", "success"), [(1, 0.97), (20, 0.0)])
def test_a_failure_does_not_mean_that_it_never_succeeds(failures: int, success: float) -> None:
    seen = [MeasuredFiring("n.work", 1.0, failed=True)] * failures
    found = estimate([NET], seen)["n"]["work"].success
    assert found is not None
    assert found[0] == success
