"""The judgement of growth, against lines whose slope is known."""

import os
from dataclasses import replace

import numpy as np
import pytest

from bench.soak.samples import WEEK_S, Sample, Trend, after_warm_up, lines, sample

FLAT = Sample("calibration", 0.0, 10.0, 1000.0, 300.0, 180.0, 220.0, 3.0)


def run(count=60, noise=0.0, **growth_a_week):
    """Samples ten seconds apart; the first three hold less, as a machine that has just begun."""
    rng = np.random.default_rng(1)
    made = []
    for number in range(count):
        at_s = 10.0 * number
        grown = {name: getattr(FLAT, name) + week * at_s / WEEK_S for name, week in growth_a_week.items()}
        memory = grown.pop("memory", FLAT.memory) + noise * rng.standard_normal() - (100.0 if number < 3 else 0.0)
        made.append(replace(FLAT, at_s=at_s, memory=memory, **grown))
    return made


def judged(samples):
    found = lines(samples)
    return {found[k].name.partition(",")[0]: found[k + 1] for k in range(0, len(found), 2)}


def test_what_stays_the_same_is_flat_and_the_first_commands_do_not_count():
    assert all(line.met is not False for line in judged(run()).values())
    assert len(after_warm_up(run(100))) == 90
    assert len(after_warm_up(run(5))) == 2


@pytest.mark.parametrize(
    ("name", "week"),
    [("memory", 2000.0), ("descriptors", 1e3), ("threads", 100.0), ("shm", 200.0), ("disk", 4000.0)],
)
def test_what_grows_is_named_and_nothing_else(name, week):
    verdict = judged(run(**{name: week}))
    assert [each for each, line in verdict.items() if line.met is False] == [name]
    assert verdict[name].value == pytest.approx(week, rel=1e-6)


def test_kinds_of_commands_that_differ_are_no_trend_and_one_that_slows_down_is():
    short = [replace(each, kind="short", duration_s=0.1) for each in run()]
    mixed = [pair[k % 2] for k, pair in enumerate(zip(run(), short, strict=True))]
    assert judged(mixed)["duration over the mean of its kind"].met
    slower = [replace(each, duration_s=each.duration_s * (1.0 + each.at_s / WEEK_S)) for each in mixed]
    assert judged(slower)["duration over the mean of its kind"].met is False


def test_the_process_that_grows_is_named():
    grown = [replace(each, memory_of={"servo 7": 90.0, "vss 9": 180.0 + each.at_s}) for each in run()]
    grown[-1].memory_of["vss 10"] = 1.0  # that of a process which was started again
    told = {line.name.strip(): line for line in lines(grown) if line.name.startswith("  of ")}
    assert sorted(told) == ["of servo, mean", "of vss, mean"]
    assert told["of vss, mean"].against.startswith(f"in a week {WEEK_S:+.3g}")
    assert told["of servo, mean"].value == pytest.approx(90.0)


def test_scatter_is_no_growth_and_a_short_run_proves_nothing():
    noisy = judged(run(noise=5.0))["memory"]
    assert noisy.met
    assert "estimate" in noisy.against
    few = lines(run(5, memory=1e9))
    assert {line.value for line in few} == {None}
    assert "too few commands" in few[0].against


def test_the_interval_is_that_of_student():
    rng = np.random.default_rng(2)
    at_s = np.arange(20.0)
    inside = 0
    for _ in range(400):
        trend = Trend.through(at_s, 3.0 + 0.5 * at_s + rng.standard_normal(20))
        inside += trend.low <= 0.5 <= trend.high
    assert 0.92 < inside / 400 < 0.98


def test_the_interval_holds_where_values_follow_each_other_as_steps_do():
    """Each is 0.8 of the one before and something new: counted as independent, 50 of 100 intervals have the slope."""
    rng = np.random.default_rng(3)
    at_s = np.arange(150.0)
    inside = 0
    for _ in range(400):
        off = np.zeros(150)
        for k, new in enumerate(rng.standard_normal(150)):
            off[k] = 0.8 * off[k - 1] + new
        trend = Trend.through(at_s, 3.0 + 0.5 * at_s + off)
        inside += trend.low <= 0.5 <= trend.high
    assert inside / 400 > 0.88


def test_growth_in_steps_is_found_and_one_step_is_none():
    at_s = np.arange(150.0)
    assert Trend.through(at_s, 1000.0 + np.floor(at_s / 10.0)).low > 0.09
    assert Trend.through(at_s, 1000.0 + 5.0 * (at_s > 20.0)).low < 0.0


def test_a_sample_is_of_the_processes_that_are_named(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "log").write_bytes(bytes(2**20))
    before = sample([os.getpid()], "x", 1.0, 2.0)
    files = [(tmp_path / "log").open("rb") for _ in range(5)]
    after = sample([os.getpid(), 2**30], "x", 1.0, 2.0)
    for file in files:
        file.close()
    assert after.descriptors - before.descriptors == 5
    assert (after.at_s, after.duration_s) == (1.0, 2.0)
    assert after.threads >= 1
    assert sum(after.memory_of.values()) == after.memory > 10.0
    assert after.disk == pytest.approx(1.0)
