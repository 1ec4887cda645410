"""Transitions that take their time, and guards that say what wakes them."""

import pytest

from im_pnt.errors import NetError
from im_pnt.execution.events import GuardsChanged, ObjectInvalidated, TokenArrived
from im_pnt.execution.functions import ActionContext, Functions, woken_by
from im_pnt.model.net import Guard
from im_pnt.netfile import parse_net
from support.process import Clock, Process, hold


def net(transitions: str, places: str = "a: 1, b: , c: "):
    return parse_net(f"net: n\nplaces: {{{places}}}\ntransitions: {{{transitions}}}")


def test_a_delayed_transition_fires_when_it_has_been_enabled_so_long():
    process = Process([net("t: {in: a, out: b, delay: 2}")], clock=Clock())
    process.wait(1.9)
    assert process.marking("n") == {"a": 1}
    process.wait(0.2)
    assert process.marking("n") == {"b": 1}


def test_the_faster_wins_the_race_and_an_immediate_one_beats_both():
    process = Process([net("t: {in: a, out: b, delay: 2}, u: {in: a, out: c, delay: 1}")], clock=Clock())
    process.wait(5.0)
    assert process.marking("n") == {"c": 1}
    process = Process([net("t: {in: a, out: b, delay: 2}, u: {in: a, out: c}")], clock=Clock())
    process.wait(5.0)
    assert process.marking("n") == {"c": 1}


def test_a_transition_that_was_disabled_waits_anew():
    transitions = "t: {in: [a, r], out: b, delay: 2}, u: {in: [r, c], out: s, delay: 1.5}, v: {in: s, out: r, delay: 1}"
    process = Process([net(transitions, "a: 1, b: , c: 1, r: 1, s: ")], clock=Clock())
    process.wait(4.4)
    assert process.marking("n") == {"a": 1, "r": 1}
    process.wait(0.2)
    assert process.marking("n") == {"b": 1}


def test_a_firing_that_gives_back_what_it_takes_disables_nobody():
    transitions = "t: {in: [a, r], out: b, delay: 2}, u: {in: [r, c], out: [r, d], delay: 1.5}"
    process = Process([net(transitions, "a: 1, b: , c: 1, d: , r: 1")], clock=Clock())
    process.wait(2.1)
    assert process.marking("n") == {"b": 1, "d": 1}


def test_one_server_fires_one_token_after_the_other():
    process = Process([net("t: {in: a, out: b, delay: 1}", "a: 3, b: ")], clock=Clock())
    process.wait(2.5)
    assert process.marking("n") == {"a": 1, "b": 2}


@pytest.mark.parametrize(("servers", "fired"), [(2, {1.1: 2, 2.1: 4, 3.1: 5}), ("inf", {1.1: 5})])
def test_so_many_servers_time_their_tokens_together(servers, fired):
    process = Process([net(f"t: {{in: a, out: b, delay: 1, servers: {servers}}}", "a: 5, b: ")], clock=Clock())
    now = 0.0
    for time, count in fired.items():
        process.wait(time - now)
        now = time
        assert process.marking("n").get("b") == count


def test_a_token_that_comes_later_has_a_time_of_its_own_and_a_bunch_is_one():
    """Clocks run for full bunches only: at 0 there is one, at 0.5 the fourth token makes the second."""
    transitions = "t: {in: {a: 2}, out: b, delay: 2, servers: inf}, u: {in: c, out: a, delay: 0.5}"
    process = Process([net(transitions, "a: 3, b: , c: 1")], clock=Clock())
    process.wait(2.1)
    assert process.marking("n") == {"a": 2, "b": 1}
    process.wait(0.5)
    assert process.marking("n") == {"b": 2}


def test_where_a_token_leaves_the_time_that_began_last_is_forgotten():
    transitions = """
      t: {in: a, out: b, delay: 2, servers: inf}, come: {in: c, out: a, delay: 0.5}, go: {in: [a, d], out: e, delay: 1}
    """
    process = Process([net(transitions, "a: 1, b: , c: 1, d: 1, e: ")], clock=Clock())
    process.wait(2.1)
    assert process.marking("n") == {"b": 1, "e": 1}


def test_tokens_whose_time_runs_stay_where_inhibitors_see_them():
    transitions = """
      feed: {in: s, out: a, delay: 1}, t: {in: a, out: b, delay: 2, servers: inf},
      u: {in: c, inhibitors: {a: 2}, out: d}, start: {in: e, out: c, delay: 2.5}
    """
    process = Process([net(transitions, "a: 1, b: , c: , d: , e: 1, s: 2")], clock=Clock())
    process.wait(2.6)  # one went at 2, two came at 1 and 2: they go at 3 and 4
    assert process.marking("n") == {"a": 2, "b": 1, "c": 1}
    process.wait(0.5)
    assert process.marking("n") == {"a": 1, "b": 2, "d": 1}


def test_exponential_delays_have_their_mean_and_are_repeatable():
    def run(seed: int) -> list[float]:
        process = Process([net("t: {in: a, out: a, delay: {exponential: {mean: 2}}}")], clock=Clock(), seed=seed)
        process.wait(4000.0)
        return [firing.duration for firing in process.recorder.firings] + [float(len(process.recorder.firings))]

    assert 1800 < run(1)[-1] < 2200
    assert run(1) == run(1)
    assert run(1) != run(2)


def test_a_delay_begins_when_its_guard_lets_it_and_is_void_when_it_does_not_in_the_end():
    allowed = [False]
    process = Process(
        [net("t: {in: a, out: b, delay: 2, guard: g}")], guards={"g": lambda ctx: allowed[0]}, clock=Clock()
    )
    executor = process.exchange.nets["n"]
    process.wait(3.0)
    allowed[0] = True
    executor.post(GuardsChanged())
    process.wait(1.0)
    allowed[0] = False
    process.wait(2.0)
    assert process.marking("n") == {"a": 1}
    allowed[0] = True
    executor.post(GuardsChanged())
    process.wait(1.9)
    assert process.marking("n") == {"a": 1}
    process.wait(0.2)
    assert process.marking("n") == {"b": 1}


@pytest.mark.parametrize("sources", [None, ("topic:/t",), ("clock:0.5",)])
def test_a_delay_whose_guard_was_false_meanwhile_begins_anew(sources):
    allowed = [True]

    def guard(ctx: ActionContext) -> bool:
        return allowed[0]

    told = guard if sources is None else woken_by(*sources)(guard)
    process = Process([net("t: {in: a, out: b, delay: 5, guard: g}")], guards={"g": told}, clock=Clock())
    executor = process.exchange.nets["n"]

    def become(lets: bool) -> None:
        allowed[0] = lets
        if sources != ("clock:0.5",):
            executor.post(GuardsChanged(sources[0] if sources else ""))

    process.wait(1.1)
    become(False)
    process.wait(3.8)
    become(True)
    process.wait(4.8)
    assert process.marking("n") == {"a": 1}
    process.wait(0.8)
    assert process.marking("n") == {"b": 1}


def test_nothing_is_to_be_woken_for_while_nothing_waits_for_the_clock():
    timed = "t: {in: a, out: b, action: f, on_failure: c, timeout: 60}"
    process = Process([net(timed, "a: 1000, b: , c: ")], {"f": hold}, clock=Clock())
    process.pump()
    executor = process.exchange.nets["n"]
    assert executor.next_wakeup() == pytest.approx(60.0)
    assert not executor.due
    for entry in process.held:
        executor.ended(entry[1], None)
    process.pump()
    assert executor.next_wakeup() is None


def declared(*sources: str, allowed: list[bool], calls: list[str]):
    @woken_by(*sources)
    def guard(ctx: ActionContext) -> bool:
        calls.append(ctx.transition)
        return allowed[0]

    return guard


def test_a_guard_that_says_what_wakes_it_is_asked_when_that_happens_and_not_otherwise():
    allowed, calls = [False], []
    guard = declared("data:destination", "topic:/mcs/state", allowed=allowed, calls=calls)
    process = Process([net("t: {in: a, out: b, guard: g}", "a: 1, b: , c: {remote: true}")], guards={"g": guard})
    executor = process.exchange.nets["n"]
    assert process.functions.wakes(executor.net) == {"data:destination", "topic:/mcs/state"}
    process.pump()
    assert len(calls) == 1
    for event in (GuardsChanged("topic:/other"), TokenArrived("c", 1), ObjectInvalidated("other")):
        executor.post(event)
        process.pump()
    assert len(calls) == 1
    for event in (GuardsChanged("topic:/mcs/state"), ObjectInvalidated("destination"), GuardsChanged()):
        executor.post(event)
        process.pump()
    assert len(calls) == 4
    allowed[0] = True
    executor.post(GuardsChanged("data:destination"))
    process.pump()
    assert process.marking("n") == {"b": 1, "c": 1}


def test_tokens_that_it_contends_for_wake_it_too():
    allowed, calls = [False], []
    guard = declared("topic:/t", allowed=allowed, calls=calls)
    process = Process([net("t: {in: a, out: b, guard: g}", "a: {tokens: 1, remote: true}, b: ")], guards={"g": guard})
    process.pump()
    process.exchange.nets["n"].post(TokenArrived("a", 1))
    process.pump()
    assert len(calls) == 2


def test_a_clock_wakes_a_guard_as_long_as_it_holds_something_back():
    allowed, calls = [False], []
    guard = declared("clock:0.5", allowed=allowed, calls=calls)
    process = Process([net("t: {in: a, out: b, guard: g}")], guards={"g": guard}, clock=Clock())
    process.wait(1.6)
    assert len(calls) == 4
    allowed[0] = True
    process.wait(0.5)
    assert process.marking("n") == {"b": 1}
    process.wait(10.0)
    assert len(calls) == 5
    assert process.exchange.nets["n"].next_wakeup() is None


@pytest.mark.parametrize("source", ["destination", "clock:", "clock:0", "clock:nan", "clock:soon", "place:a"])
def test_a_source_that_is_none_is_refused(source):
    with pytest.raises(NetError, match=source):
        woken_by(source)


def test_guards_that_say_nothing_wake_to_nothing_in_particular():
    assert Functions(guards={"g": lambda ctx: True}).sources(Guard("g")) is None
