import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.execution.conflicts import entropy, probabilities
from im_pnt.execution.events import CommandCancelled
from im_pnt.execution.strategies import StrategyBook
from im_pnt.model.net import Strategy
from im_pnt.netfile import parse_net
from support.process import Process, hold

NET = """
net: n
places: {todo: 1, done: , bad: }
transitions:
  left: {in: todo, out: todo, action: left, on_failure: todo, strategy: {}}
  right: {in: todo, out: todo, action: right, on_failure: todo, strategy: {}, weight: 2}
"""


def fails() -> None:
    raise ImError("it does not work that way")


@given(st.lists(st.booleans(), max_size=30), st.floats(0.0, 1.0), st.floats(0.1, 5.0), st.floats(0.1, 5.0))
def test_counts_are_decayed_sums_of_outcomes(outcomes, decay, successes, failures):
    strategy, book = Strategy(successes, failures, decay), StrategyBook()
    for outcome in outcomes:
        book.outcome("n", "t", strategy, outcome)
    ages = range(len(outcomes) - 1, -1, -1)
    n = len(outcomes)
    expected = (
        successes * decay**n + sum(decay**age for age, outcome in zip(ages, outcomes, strict=True) if outcome),
        failures * decay**n + sum(decay**age for age, outcome in zip(ages, outcomes, strict=True) if not outcome),
    )
    assert book.counts("n", "t", strategy) == pytest.approx(expected)
    assert 0.0 <= book.mean_success("n", "t", strategy) <= 1.0


@given(st.lists(st.floats(0.0, 10.0), min_size=1, max_size=8))
def test_entropy_is_between_that_of_certainty_and_of_ignorance(weights):
    distribution = probabilities(weights)
    assert math.fsum(distribution) == pytest.approx(1.0)
    assert -1e-12 <= entropy(distribution) <= math.log(len(weights)) + 1e-12


def test_entropy_of_a_fair_coin_is_a_nat_times_ln_2():
    assert entropy([0.5, 0.5]) == pytest.approx(math.log(2.0))
    assert entropy([1.0, 0.0]) == 0.0


def test_what_works_is_learned_and_the_choice_and_its_entropy_are_told():
    process = Process([parse_net(NET)], {"left": lambda ctx: None, "right": lambda ctx: fails()}, seed=2)
    executor = process.exchange.nets["n"]
    executor.pump(500)
    choices = process.recorder.choices
    assert choices[0] == (
        ("todo",),
        {"left": pytest.approx(1 / 3), "right": pytest.approx(2 / 3)},
        pytest.approx(-math.log(1 / 3) / 3 - 2 * math.log(2 / 3) / 3),
        choices[0][3],
    )
    for _, distribution, uncertainty, taken in choices:
        assert taken in distribution
        assert uncertainty == pytest.approx(entropy(list(distribution.values())))
    late = [taken for _, _, _, taken in choices[-100:]]
    assert late.count("left") > 90
    assert choices[-1][2] < choices[0][2]


def test_the_choices_are_repeatable_from_a_seed():
    def run(seed: int) -> list[str]:
        dice = random.Random(9)
        act = {"left": lambda ctx: dice.random() < 0.5 or fails(), "right": lambda ctx: dice.random() < 0.7 or fails()}
        process = Process([parse_net(NET)], act, seed=seed)
        process.exchange.nets["n"].pump(100)
        return process.recorder.names("n")

    assert run(1) == run(1)
    assert run(1) != run(2)


def test_probabilities_are_proportional_to_weight_and_mean_success():
    book = StrategyBook()
    for _ in range(8):
        book.outcome("n", "left", Strategy(), True)
    process = Process([parse_net(NET)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    assert process.recorder.choices[0][1] == pytest.approx({"left": 0.9 / 1.9, "right": 1.0 / 1.9})


def test_cancelled_actions_teach_nothing():
    book = StrategyBook()
    process = Process([parse_net(NET)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    taken = process.held[0][1].transition
    process.exchange.nets["n"].post(CommandCancelled(None, ImError("enough", code="cancelled")))
    process.pump()
    process.end(taken, ImError("enough", code="cancelled"))
    assert book.counts("n", taken, Strategy()) == (1.0, 1.0)
    process.end(process.held[0][1].transition)
    assert book.counts("n", process.recorder.firings[-2].transition, Strategy()) == (2.0, 1.0)
