import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.execution.conflicts import entropy, probabilities
from im_pnt.execution.events import CommandCancelled
from im_pnt.execution.strategies import DONE, Experience, StrategyBook, StrategyOutcome, chances_of_best
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

LEARNS = Strategy()


def fails() -> None:
    raise ImError("it does not work that way")


def outcome(name="n.t", success=True, strategy=LEARNS, rivals=()):
    return StrategyOutcome(name, strategy, DONE if success else "broken", rivals)


@given(st.lists(st.booleans(), max_size=30), st.floats(0.1, 1.0), st.floats(0.1, 5.0), st.floats(0.1, 5.0))
def test_counts_are_decayed_sums_of_outcomes_above_the_prior(outcomes, decay, successes, failures):
    strategy, book = Strategy(successes, failures, decay), StrategyBook()
    for success in outcomes:
        book.outcome(outcome("n.t", success, strategy))
    ages = range(len(outcomes) - 1, -1, -1)
    expected = (
        successes + sum(decay**age for age, success in zip(ages, outcomes, strict=True) if success),
        failures + sum(decay**age for age, success in zip(ages, outcomes, strict=True) if not success),
    )
    experience = book.experience("n.t", strategy)
    assert experience.counts == pytest.approx(expected)
    low, high = experience.interval()
    assert 0.0 <= low <= high <= 1.0
    assert experience.last == ({True: DONE, False: "broken"}[outcomes[-1]] if outcomes else "")


def test_an_outcome_lets_fade_what_is_known_of_rivals():
    book, strategy = StrategyBook(), Strategy(decay=0.5)
    book.outcome(outcome("n.t", False, strategy))
    for _ in range(10):
        book.outcome(outcome("n.u", True, strategy, ("n.t", "n.u", "n.never_tried")))
    assert book.experience("n.t", strategy).counts == pytest.approx((1.0, 1.0), abs=0.001)
    assert "n.never_tried" not in book.learned


@given(
    st.lists(st.tuples(st.floats(0.5, 30.0), st.floats(0.5, 30.0), st.floats(0.05, 20.0)), min_size=2, max_size=4),
    st.integers(0, 2**31 - 1),
)
@settings(max_examples=25, deadline=None)
def test_chances_are_those_of_thompson_sampling(alternatives, seed):
    dice, n = random.Random(seed), 4000
    wins = [0] * len(alternatives)
    for _ in range(n):
        costs = [cost / max(dice.betavariate(a, b), 1e-12) for a, b, cost in alternatives]
        wins[costs.index(min(costs))] += 1
    chances = chances_of_best(alternatives)
    assert math.fsum(chances) == pytest.approx(1.0)
    assert chances == pytest.approx([count / n for count in wins], abs=0.05)


def test_the_interval_of_nothing_learned_and_of_much():
    assert Experience().interval() == pytest.approx((0.05, 0.95), abs=0.01)
    low, high = Experience(900.0, 100.0).interval()
    assert 0.87 < low < 0.9 < high < 0.93


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
        {"left": pytest.approx(0.25, abs=0.01), "right": pytest.approx(0.75, abs=0.01)},
        pytest.approx(entropy([0.25, 0.75]), abs=0.01),
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
        process = Process([parse_net(NET.replace(", weight: 2", ""))], act, seed=seed)
        process.exchange.nets["n"].pump(100)
        return process.recorder.names("n")

    assert run(1) == run(1)
    assert len({tuple(run(seed)) for seed in range(8)}) > 1


def test_what_costs_less_until_it_succeeds_is_preferred_and_others_keep_their_weight():
    book = StrategyBook()
    for _ in range(40):
        book.outcome(outcome("n.left", True))
        book.outcome(outcome("n.right", success=False))
        book.outcome(outcome("n.right", True))
    cheap = NET.replace("strategy: {}, weight: 2", "strategy: {}, delay: 0.1")
    process = Process([parse_net(cheap)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    assert process.recorder.choices[0][1]["right"] > 0.999  # 0.1 s / 0.5 costs less than 1 s / 1
    plain = NET + "  third: {in: todo, out: todo, action: left, on_failure: todo, weight: 3}\n"
    process = Process([parse_net(plain)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    assert process.recorder.choices[0][1]["third"] == pytest.approx(0.5)


ASKED = """
net: n
places: {todo: , done: , bad: }
commands: {go: {arguments: {kind: {type: string}}}}
transitions:
  go: {symbol: go, in: [], out: todo}
  left: {in: todo, out: done, action: left, on_failure: bad, strategy: {context: "${arguments.kind}"}}
  right: {in: todo, out: done, action: right, on_failure: bad, strategy: {context: "${arguments.kind}"}}
  good: {in: done, out: [], emit: go_done}
  ill: {in: bad, out: [], emit: go_failed}
"""


def test_experience_of_one_kind_of_object_is_not_used_for_another():
    book = StrategyBook()
    left = {"box": True, "rod": False}

    def take_left(ctx):
        return left[ctx.request_arguments["kind"]] or fails()

    def take_right(ctx):
        return not left[ctx.request_arguments["kind"]] or fails()

    process = Process([parse_net(ASKED)], {"left": take_left, "right": take_right}, strategies=book, seed=3)
    for number in range(80):
        process.command("n", "go", kind=("box", "rod")[number % 2])
        process.pump()
    assert book.learned.keys() == {f"n.{way}@{kind}" for way in ("left", "right") for kind in left}
    assert book.experience("n.left@box", LEARNS).mean > 0.9 > 0.5 > book.experience("n.left@rod", LEARNS).mean


def test_cancelled_actions_teach_nothing():
    book = StrategyBook()
    process = Process([parse_net(NET)], {"left": hold, "right": hold}, strategies=book)
    process.pump()
    taken = process.held[0][1].transition
    process.exchange.nets["n"].post(CommandCancelled(None, ImError("enough", code="cancelled")))
    process.pump()
    process.end(taken, ImError("enough", code="cancelled"))
    assert book.experience(f"n.{taken}", LEARNS).counts == (1.0, 1.0)
    process.end(process.held[0][1].transition)
    assert book.experience(f"n.{process.recorder.firings[-2].transition}", LEARNS).counts == (2.0, 1.0)
