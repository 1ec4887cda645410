"""docs/tutorials/control_law.md: its law is loaded, configured, switched to and followed, as the page says."""

import ast
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from im_core.errors import ConfigError
from im_mcs.limits.configuration import McsConfig

PAGE = Path(__file__).resolve().parents[4] / "docs" / "tutorials/control_law.md"
LAW = "my_laws:SlidingMode"


@pytest.fixture(scope="module")
def blocks():
    """The law, what makes it one to switch to, and what moves it into a process of its own."""
    found = re.findall(r"^```(python|yaml)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    assert [language for language, _ in found] == ["python", "yaml", "yaml"]
    return dict(zip(("python", "yaml", "process"), (block for _, block in found), strict=True))


@pytest.fixture
def tutorial(blocks, config, tmp_path, monkeypatch):
    """``mcs.yaml`` with what the page adds to it; the law can be imported."""
    (tmp_path / "my_laws.py").write_text(blocks["python"], encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    data = config.model_dump()
    data["switching"]["laws"] |= yaml.safe_load(blocks["yaml"])["switching"]["laws"]
    return data


def test_it_has_thirty_lines(blocks):
    imports = (ast.Import, ast.ImportFrom)
    tree = ast.parse(blocks["python"])
    written = [line for line in blocks["python"].splitlines() if line.strip()]
    imported = sum(isinstance(node, imports) for node in tree.body)
    assert len(written) - imported <= 30


def test_it_is_switched_to_and_follows(tutorial, plant_bench, cell):
    bench = plant_bench(McsConfig.model_validate(tutorial), 1)
    bench.to_motion("left")
    assert bench.ask("set_controller", group="left", controller=LAW)["success"]
    plant, worst = bench.driver.plant, 0.0
    q = plant.q

    def watch():
        nonlocal worst, q
        worst = max(worst, np.abs(bench.mcs.setpoint[0] - q)[:9].max())
        q = plant.q

    target = cell.home[:9] + np.array([0.3, 0.5, 0.2, 0.6, -0.5, 0.6, 0.7, 0.7, 0.7])
    reply = bench.move("left", target, on_tick=watch)
    assert reply["success"], reply
    assert worst < 1e-3
    np.testing.assert_allclose(plant.q[:9], target, atol=5e-5)


def test_it_carries_the_arms_from_the_start_too(tutorial, plant_bench, cell):
    tutorial["control"] = {"controller": LAW, "parameters": tutorial["switching"]["laws"].pop(LAW)}
    bench = plant_bench(McsConfig.model_validate(tutorial), 2)
    bench.to_motion("left", "right")
    assert bench.mcs.groups["right"].controller.name == LAW
    np.testing.assert_allclose(bench.driver.plant.q, cell.home, atol=5e-5)


def test_a_wrong_parameter_is_named_before_anything_moves(tutorial, make_bench):
    tutorial["switching"]["laws"][LAW]["push"] = -1.0
    with pytest.raises(ConfigError, match="'push'"):
        make_bench(McsConfig.model_validate(tutorial))


def test_it_carries_an_arm_from_a_process_of_its_own(tutorial, blocks, make_bench, tmp_path, monkeypatch, cell):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(tmp_path), *sys.path]))
    tutorial |= yaml.safe_load(blocks["process"])
    bench = make_bench(McsConfig.model_validate(tutorial))
    try:
        bench.to_motion("left")
        controller = bench.mcs.groups["left"].controller
        assert bench.ask("set_controller", group="left", controller=LAW)["success"]
        assert controller.name == LAW
        assert not controller.switching
        np.testing.assert_allclose(bench.driver.q, cell.home, atol=1e-4)
    finally:
        bench.mcs.close()
