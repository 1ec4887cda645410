"""The tasks of ``docs/nets/tasks``: each is verified and played; their scenarios execute them."""

import re
from pathlib import Path

import pytest

from im_pnt.netfile import load_net
from im_pnt_analysis.simulation.simulate import summarise
from im_pnt_analysis.verify.verdict import verify

TASKS = Path(__file__).resolve().parents[4] / "docs" / "nets" / "tasks"
TOGETHER = {"polishing_cell": ("polishing_cell", "polisher")}
NAMES = sorted({path.stem for path in TASKS.glob("*.yaml")} - {"polisher"})


def nets_of(name):
    return [load_net(TASKS / f"{each}.yaml") for each in TOGETHER.get(name, (name,))]


def test_there_are_twenty_and_the_page_lists_them():
    assert len(NAMES) >= 20
    page = (TASKS.parents[1] / "nets.md").read_text(encoding="utf-8")
    assert set(re.findall(r"\(nets/tasks/(\w+)\.yaml\)", page)) == {path.stem for path in TASKS.glob("*.yaml")}


@pytest.mark.parametrize("name", NAMES)
def test_a_task_is_verified_and_nothing_in_it_is_in_vain(name):
    report = verify(nets_of(name))
    report.require_ok()
    assert not report.never_enabled


@pytest.mark.parametrize("name", NAMES)
def test_a_task_is_played_and_does_not_get_stuck(name):
    summary = summarise(nets_of(name), seed=1, steps=2000, failures=0.05)
    assert not summary.stuck
    assert summary.firings == 2000
