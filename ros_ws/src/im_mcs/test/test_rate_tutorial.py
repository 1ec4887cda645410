"""docs/tutorials/servo_rate.md: its functions, its processes and its collision monitor do what the page says."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml

from im_core.errors import ConfigError
from im_core.rate_groups import RateGroups
from im_mcs.limits.configuration import McsConfig
from im_mcs.servo.functions import ServoFunctions

PAGE = Path(__file__).resolve().parents[4] / "docs" / "tutorials/servo_rate.md"


@pytest.fixture(scope="module")
def blocks():
    return re.findall(
        r"^```(python|yaml) ?(\S*)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


@pytest.fixture
def folder(blocks, tmp_path, monkeypatch):
    """The files of the page; what they make can be imported, by other processes too."""
    for language, name, text in blocks:
        if language == "python":
            (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(os.getpid()))  # the shared memory of no machine
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for module in tmp_path.glob("my_*.py"):
        sys.modules.pop(module.stem, None)


@pytest.fixture
def tutorial(blocks, frictionless):
    """``mcs.yaml`` with what the page adds to it, and time enough for a busy computer."""
    data = frictionless.model_dump()
    for language, _, text in blocks:
        if language == "yaml":
            for section, values in yaml.safe_load(text).items():
                data[section] |= values
    data["functions"]["share"]["budget_s"] = 60.0
    return data


def test_a_process_is_awake_in_every_tick(folder, tutorial, make_bench, cell):
    tutorial["collision"].pop("monitor")
    config = McsConfig.model_validate(tutorial)
    bench, rates = make_bench(config), RateGroups(config.servo.period_s)
    functions = ServoFunctions(config.functions, bench.mcs, rates)
    command = [sys.executable, str(folder / "my_process.py")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        bench.to_motion("left")
        ticks = iter(range(100_000))
        reply = bench.move("left", cell.home[:9] + 0.2, on_tick=lambda: rates.run(next(ticks)))
        assert reply["success"], reply["error"]
        told, _ = process.communicate(timeout=90.0)
    functions.close()
    assert not rates.statistics()[0].ended
    assert re.fullmatch(r"100 ticks, at most -?\d+\.\d W\n", told)
    assert not rates.statistics()[0].ended
    assert rates.statistics()[0].calls == next(ticks)
    ticks_of = import_module("my_ticks")
    assert not list(Path("/dev/shm").glob(f"*{ticks_of.NAME}*"))


def test_the_loop_of_its_own(folder):
    told = subprocess.run(
        [sys.executable, str(folder / "my_loop.py")], capture_output=True, text=True, timeout=60.0, check=True
    ).stdout
    found = re.findall(r"^(\w+): (\d+) calls, (\d+) missed, \d+ % of the period$", told, re.MULTILINE)
    calls = {name: (int(calls), int(missed)) for name, calls, missed in found}
    assert calls["filter"][0] == 10
    periods = sum(calls["filter"])  # more than ten, if a busy computer misses some
    assert sum(calls["controller"]) == len(range(2, periods, 5))
    assert calls["sampler"][0] == 20


def test_the_wrists_stop_a_metre_apart(folder, tutorial, make_bench, cell):
    """The track carries the left arm towards the right one, on a path that the shapes of the cell allow."""
    tutorial["functions"] = {}
    bench = make_bench(McsConfig.model_validate(tutorial))
    model, limits = bench.mcs.model, bench.mcs.limits.motion
    monitor = import_module("my_monitor").WristsApart(model, limits, bench.mcs.config.collision, [], 0.0045)
    target = cell.home.copy()
    target[0] += 1.4
    assert monitor.distance(target) < 0.0 < monitor.distance(cell.home)
    bench.to_motion("left")
    reply = bench.move("left", target[:9])
    assert not reply["success"]
    assert "left_wrist and right_wrist come too close" in reply["error"]["message"]
    assert abs(monitor.distance(bench.driver.q)) < bench.mcs.config.collision.slow_down_m


def make_monitor(answer):
    class Monitor:
        def __init__(self, *setup): ...

        def update(self, q, v, a, curves):
            return answer()

    return Monitor


@pytest.mark.parametrize("answer", [lambda: 1 / 0, lambda: None, lambda: "far", sys.exit])
def test_a_monitor_that_fails_is_an_emergency_stop_with_its_name(config, make_bench, monkeypatch, answer):
    monkeypatch.setattr("im_mcs.collision.monitor.CollisionMonitor", make_monitor(answer))
    bench = make_bench(config)
    for request in ({"request": "reserve", "group": "left"}, {"request": "power_on"}, {"request": "enable_motion"}):
        bench.ask(**request)
    assert bench.mcs.manager.state.value == "estopped"
    assert "collision monitor 'im_mcs.collision.monitor:CollisionMonitor'" in bench.mcs.manager.cause


@pytest.mark.parametrize(
    ("section", "change", "named"),
    [
        ("collision", {"monitor": "im_mcs.collision:Nothing"}, "collision monitor 'im_mcs.collision:Nothing'"),
        ("planning", {"generators": {"joint": "im_mcs.nowhere:Path"}}, "trajectory generator 'im_mcs.nowhere:Path'"),
        ("planning", {"generators": {"line": "no reference"}}, "planning.generators.line"),
        ("functions", {"f": {"function": "os:getcwd", "budget_s": 1.0}}, "servo function 'os:getcwd'"),
        ("functions", {"f": {"function": "os:getcwd", "budget_s": 0.0}}, "functions.f.budget_s"),
        (
            "functions",
            {"f": {"function": "os:getcwd", "budget_s": 1.0, "every": 2, "phase": 2}},
            "2 is not from 0 to 1",
        ),
        ("functions", {"f": {"function": "os:getcwd", "budget_s": 1.0, "every": 2, "times": 2}}, "one of them is 1"),
    ],
)
def test_wrong_names_are_refused_before_anything_moves(config, make_bench, section, change, named):
    data = config.model_dump()
    data[section] |= change
    with pytest.raises((ConfigError, ValueError), match=re.escape(named)):
        start(data, make_bench)


def start(data, make_bench):
    config = McsConfig.model_validate(data)
    ServoFunctions(config.functions, make_bench(config).mcs, RateGroups(config.servo.period_s))


class Straight:
    """A joint motion by one quintic, as slow as it needs to be."""

    def __init__(self, context, move, start):
        self.context, self.move, self.start = context, move, start

    def step(self):
        from im_mcs.planning.trajectories.polynomial import PiecewisePolynomial, quintic

        ends = np.array([self.start().q, self.move.points[-1]])
        at_rest = np.zeros_like(ends)
        return PiecewisePolynomial([4.0], quintic(np.array([4.0]), ends, at_rest, at_rest))


def test_a_generator_of_ours_moves_the_arm(frictionless, make_bench, cell, monkeypatch):
    monkeypatch.setattr("im_mcs.planning.motions.joint.Straight", Straight, raising=False)
    data = frictionless.model_dump()
    data["planning"]["generators"]["joint"] = "im_mcs.planning.motions.joint:Straight"
    bench = make_bench(McsConfig.model_validate(data))
    bench.to_motion("left")
    target, seen = cell.home[:9] + 0.1, []
    reply = bench.move("left", target, on_tick=lambda: seen.append(bench.mcs.setpoint[0][:9].copy()))
    assert reply["success"], reply["error"]
    assert 4.0 <= reply["results"]["duration"] < 5.0  # with the time until it rests
    np.testing.assert_allclose(bench.driver.q[:9], target, atol=1e-4)
    half = min(seen, key=lambda q: abs(q[0] - cell.home[0] - 0.05))
    np.testing.assert_allclose(half, cell.home[:9] + 0.05, atol=1e-3)
