"""When cameras take images without being asked, on clocks that run by themselves and on one that runs when wanted."""

import math
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from im_vss.image_rate import Rhythm

TICK_NS = 4_500_000
RATES = st.dictionaries(st.sampled_from(["wall", "table", "left"]), st.floats(0.5, 10.0), min_size=1)
EXPOSURES = st.integers(1, 100)


def rhythm_of(rates):
    rhythm = Rhythm()
    for camera, rate in rates.items():
        rhythm.set_rate(camera, rate)
    return rhythm


@given(RATES, EXPOSURES, st.integers(0, 10**6))
def test_time_that_only_images_make_pass_brings_no_image(rates, exposure, start):
    """Clock factor 0: the clock stands unless an exposure runs."""
    rhythm, now, found = rhythm_of(rates), start * TICK_NS, []
    for _ in range(20):
        if cameras := rhythm.due(now):
            found += cameras
            now += exposure * TICK_NS
            rhythm.taken(cameras, now + TICK_NS)
    assert sorted(found) == sorted(rates)
    now += math.ceil(1e9 / min(rates.values())) + 2 * TICK_NS  # somebody wants a period of the slowest
    assert sorted(rhythm.due(now)) == sorted(rates)


@given(RATES, st.integers(1, 4), st.integers(0, 10**6))
def test_on_a_clock_that_runs_each_period_has_its_image(rates, exposure, start):
    """Short exposures, and cameras of which one may be late by an exposure of the others."""
    rhythm, now, seen, free = rhythm_of(rates), start * TICK_NS, {camera: [] for camera in rates}, 0
    for _ in range(1000):
        if now >= free and (cameras := rhythm.due(now)):
            for camera in cameras:
                seen[camera].append(int(now * rates[camera] / 1e9))
            free = now + exposure * TICK_NS
            rhythm.taken(cameras, free + TICK_NS)
        now += TICK_NS
    for camera, periods in seen.items():
        assert all(b > a for a, b in pairwise(periods))
        assert len(periods) >= rates[camera] * 1000 * TICK_NS * 1e-9 * (1.0 if len(rates) == 1 else 0.7) - 1.0


@given(st.floats(0.5, 10.0), st.lists(st.integers(0, 10**4), min_size=1, max_size=50))
def test_cameras_of_one_rate_are_due_together(rate, steps):
    rhythm, now = rhythm_of({"wall": rate, "table": rate}), 0
    for step in steps:
        now += step * TICK_NS
        assert rhythm.due(now) in ((), ("wall", "table"))


def test_a_testbed_that_begins_anew_does_not_stop_the_images():
    rhythm = rhythm_of({"wall": 5.0})
    assert rhythm.due(1000 * 10**9) == ("wall",)
    rhythm.taken(("wall",), 1000 * 10**9 + 18_000_000)
    assert rhythm.due(0) == ("wall",)
    rhythm.taken(("wall",), 18_000_000)
    assert rhythm.due(190_000_000) == ()
    assert rhythm.due(200_000_000) == ("wall",)


def test_rates_come_and_go():
    rhythm = Rhythm()
    assert (rhythm.active, rhythm.due(10**9)) == (False, ())
    rhythm.set_rate("wall", 5.0)
    assert rhythm.due(10**9) == ("wall",)
    rhythm.set_rate("wall", 5.0)  # again: nothing changes
    assert rhythm.due(10**9) == ()
    rhythm.set_rate("wall", 0.0)
    rhythm.taken(("wall",), 2 * 10**9)  # the last one, still under way
    assert (rhythm.active, rhythm.due(3 * 10**9)) == (False, ())


@given(RATES, EXPOSURES, st.integers(0, 10**6))
def test_it_says_when_the_next_image_is_due(rates, exposure, start):
    """The first tick from that time on, and none before, brings an image, also where an exposure has just ended."""
    rhythm, now = rhythm_of(rates), start * TICK_NS
    assert rhythm_of({}).next_ns is None
    assert rhythm.next_ns == 0
    for _ in range(10):
        now = max(now, -(-rhythm.next_ns // TICK_NS) * TICK_NS)
        cameras = rhythm.due(now)
        assert cameras
        now += exposure * TICK_NS
        rhythm.taken(cameras, now + TICK_NS)
        while now + TICK_NS < rhythm.next_ns:
            now += TICK_NS
            assert rhythm.due(now) == ()
