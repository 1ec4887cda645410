"""Firing: what is chosen and marked, that it does not matter who looks on, and that work does not grow with the net."""

import asyncio

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.execution.events import CommandCancelled
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.notification import Observer
from im_pnt.model.action import FunctionAction
from im_pnt.model.net import Guard, Net, Place, Transition
from support.process import Process

PLACES = tuple("abcdef")


@st.composite
def nets(draw) -> Net:
    """Small nets with actions and self-loops; half of them with weights, inhibitors, guards and priorities too."""
    plain = draw(st.booleans())
    some = st.lists(st.sampled_from(PLACES), min_size=1, max_size=3, unique=True)
    weight = st.just(1) if plain else st.sampled_from([1, 1, 1, 1, 2])
    transitions = {}
    for number in range(draw(st.integers(1, 9))):
        name = f"t{number}"
        acts = draw(st.sampled_from([None, None, "f", "fails", "maybe"]))
        transitions[name] = Transition(
            name,
            inputs={place: draw(weight) for place in draw(some)},
            outputs={place: draw(weight) for place in draw(some)},
            inhibitors={} if plain else draw(st.sampled_from([{}, {}, {}, {draw(st.sampled_from(PLACES)): 3}])),
            guard=None
            if plain
            else draw(st.sampled_from([None, None, None, Guard("odd"), Guard("odd", negated=True)])),
            action=FunctionAction(acts) if acts else None,
            on_failure={draw(st.sampled_from(PLACES)): 1} if acts else {},
            priority=0 if plain else draw(st.sampled_from([0, 0, 0, 1])),
            weight=draw(st.sampled_from([1.0, 1.0, 3.0])),
        )
    return Net("n", {name: Place(name, tokens=draw(st.integers(0, 3))) for name in PLACES}, transitions)


def run(net: Net, seed: int, limits: list[int], observer: Observer | None) -> list[object]:
    """Returns the calls of actions, and the marking and sequence after each pump."""
    seen: list[object] = []

    def f(ctx: ActionContext) -> None:
        assert ctx.memory == {}
        assert ctx.result == {}
        seen.append((ctx.transition, process.exchange.nets["n"].marking()))
        ctx.memory["left"] = True

    def fails(ctx: ActionContext) -> None:
        seen.append(ctx.transition)
        raise ImError("no")

    def maybe(ctx: ActionContext) -> object:
        seen.append((ctx.transition, str(ctx.failure)))
        if len(seen) % 3 == 0:
            raise ImError("sometimes")
        return len(seen)

    process = Process(
        [net],
        {"f": f, "fails": fails, "maybe": maybe},
        {"odd": lambda ctx: len(seen) % 2 == 1},
        seed=seed,
        observer=observer,
    )
    executor = process.exchange.nets["n"]
    for limit in limits:
        executor.pump(limit)
        seen.append((executor.sequence, executor.marking()))
    return seen


@settings(max_examples=100, deadline=None)
@given(nets(), st.integers(0, 3), st.lists(st.integers(1, 60), min_size=1, max_size=3))
def test_nobody_who_looks_on_changes_anything(net, seed, limits):
    assert run(net, seed, limits, Observer()) == run(net, seed, limits, None)


def ring(size: int, action: str | None = None) -> Net:
    """One token that goes round."""
    acts = {"action": FunctionAction(action), "on_failure": {"p0": 1}} if action else {}
    places = {f"p{i}": Place(f"p{i}", tokens=int(i == 0)) for i in range(size)}
    names = list(places)
    transitions = {
        f"t{i}": Transition(f"t{i}", inputs={names[i]: 1}, outputs={names[(i + 1) % size]: 1}, **acts)
        for i in range(size)
    }
    return Net("n", places, transitions)


def philosophers(size: int) -> Net:
    """Dining philosophers who take both forks at once."""
    places = {f"{kind}{i}": Place(f"{kind}{i}", tokens=int(kind != "e")) for i in range(size) for kind in "tfe"}
    transitions = {}
    for i in range(size):
        free, eats = {f"t{i}": 1, f"f{i}": 1, f"f{(i + 1) % size}": 1}, {f"e{i}": 1}
        transitions[f"take{i}"] = Transition(f"take{i}", inputs=free, outputs=eats)
        transitions[f"put{i}"] = Transition(f"put{i}", inputs=eats, outputs=free)
    return Net("n", places, transitions)


class Counting(list):
    """A list that counts how often it is looked into."""

    touched = 0

    def __getitem__(self, index):
        self.touched += 1
        return super().__getitem__(index)


@pytest.mark.parametrize("observer", [Observer(), None])
@pytest.mark.parametrize("make", [ring, philosophers])
def test_a_firing_touches_the_transitions_next_to_the_places_that_changed_and_no_others(make, observer):
    touched = {}
    for size in (10, 100, 1000):
        process = Process([make(size)], observer=observer)
        executor = process.exchange.nets["n"]
        executor.pump(3 * size)
        enabling = executor.rule.enabling
        enabling.unmet = Counting(enabling.unmet)
        executor.pump(1000)
        touched[size] = enabling.unmet.touched / 1000
    assert touched[1000] <= 1.3 * touched[10]
    assert touched[1000] < 20


def test_an_action_that_goes_on_after_its_function_has_returned_is_one_like_any_other():
    loop = asyncio.new_event_loop()
    asked: list[str] = []
    waits = []

    async def later(ctx: ActionContext) -> None:
        ctx.on_cancel(lambda: asked.append("inside"))
        future = loop.create_future()
        waits.append(future)
        await future

    def begins(ctx: ActionContext) -> object:
        ctx.on_cancel(lambda: asked.append("before"))
        return later(ctx)

    process = Process([ring(3, "f")], {"f": begins}, observer=Observer(), spawn=loop.create_task)
    executor = process.exchange.nets["n"]
    executor.pump()
    loop.run_until_complete(asyncio.sleep(0))
    assert executor.marking() == {"t0.active": 1}
    assert [activity.transition for activity in executor.activities] == ["t0"]
    executor.post(CommandCancelled(None, ImError("enough")))
    executor.pump()
    assert executor.marking() == {"t0.cancelling": 1}
    assert sorted(asked) == ["before", "inside"]
    waits[0].set_result(None)
    loop.run_until_complete(asyncio.sleep(0))
    executor.pump()
    loop.run_until_complete(asyncio.sleep(0))
    assert executor.marking() == {"t1.active": 1}
    for task in asyncio.all_tasks(loop):
        task.cancel()
    loop.run_until_complete(asyncio.sleep(0))
    loop.close()


def test_what_an_action_sees_of_its_own_net_is_whole():
    seen: list[tuple[dict[str, int], bool, bool, str]] = []

    def looks(ctx: ActionContext) -> None:
        executor = process.exchange.nets["n"]
        assert not executor.pump()
        assert not executor.due
        seen.append((executor.marking(), executor.busy(), bool(executor.at_rest()), str(executor.at_rest())))

    process = Process([ring(2, "f")], {"f": looks}, observer=Observer())
    process.exchange.nets["n"].pump(2)
    assert seen[0] == ({"t0.active": 1}, True, False, "function f of transition t0 is active")
    assert seen[1][0] == {"t1.active": 1}
    assert process.marking("n") == {"p0": 1}


def test_an_interrupt_loses_no_token():
    def interrupted(ctx: ActionContext) -> None:
        raise KeyboardInterrupt

    for observer in (Observer(), None):
        process = Process([ring(2, "f")], {"f": interrupted}, observer=observer)
        with pytest.raises(KeyboardInterrupt):
            process.exchange.nets["n"].pump()
        assert process.marking("n") == {"t0.active": 1}
