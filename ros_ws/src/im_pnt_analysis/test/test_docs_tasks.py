"""The tasks of ``docs/nets/tasks``: each is verified, played, and executed; every command that begins ends."""

import random
import re
from pathlib import Path

import pytest

from im_core.errors import ImError
from im_pnt.model.action import FunctionAction, RequestAction
from im_pnt.netfile import load_net
from im_pnt_analysis.simulation.simulate import summarise
from im_pnt_analysis.verify.verdict import verify
from support.process import Clock, Process

TASKS = Path(__file__).resolve().parents[4] / "docs" / "nets" / "tasks"
TOGETHER = {"polishing_cell": ("polishing_cell", "polisher")}
NAMES = sorted({path.stem for path in TASKS.glob("*.yaml")} - {"polisher"})
ROUNDS = 60


class Robot(Process):
    """A process whose services, goals and topics are imagined: they succeed or fail by lot, at once."""

    def __init__(self, nets, dice, failures):
        super().__init__(nets, clock=Clock())
        self._dice, self._failures = dice, failures

    def start(self, owner, activity, context):
        if isinstance(activity.action, FunctionAction | RequestAction):
            super().start(owner, activity, context)
        else:
            failed = self._dice.random() < self._failures
            answer = {way[0]: self._dice.random() for way in context.answer_ways}  # fields of their own, and numbers
            owner.ended(activity, ImError("the lot fell on it", code="lot") if failed else None, answer)


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


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("failures", [0.05, 0.3])
def test_every_command_that_begins_ends(name, failures):
    dice = random.Random(7)
    nets = nets_of(name)
    process = Robot(nets, dice, failures)
    symbols = nets[0].symbols()
    for _ in range(ROUNDS):
        symbol = dice.choice(symbols)
        process.command(nets[0].name, symbol)
        process.wait(10.0 ** dice.uniform(0.0, 3.0))
    process.wait(1e6)
    for executor in process.exchange.nets.values():
        begun = [job for job in executor.jobs() if not job.waiting]
        assert [(job.symbol, executor.marking()) for job in begun] == []
    assert any(result.success for result in process.results)
