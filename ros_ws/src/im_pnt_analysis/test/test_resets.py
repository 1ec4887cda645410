"""Transitions that empty places: executed, verified, journalled and drawn as their definition says."""

import random
from collections import deque

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.errors import NetError, NetFileError
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Command
from im_pnt.execution.notification import Phase
from im_pnt.model.action import FunctionAction
from im_pnt.model.expand import expand
from im_pnt.model.net import Net, Place, Transition
from im_pnt.model.resources import resource_places
from im_pnt.netfile import parse_net, yaml_text
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.simulation.simulate import simulate
from im_pnt_analysis.timed.model import timed_net
from im_pnt_analysis.verify.load import verify_to_load
from im_pnt_analysis.verify.verdict import verify
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles
from support.process import Process

PLACES = tuple("abcd")
CAPACITY = 3
MOST = 3000


@st.composite
def nets(draw, *, acting: bool = False) -> Net:
    """Small nets, each with a transition that empties something."""
    arcs = st.lists(st.tuples(st.sampled_from(PLACES), st.sampled_from([1, 1, 1, 2])), max_size=2).map(dict)
    emptied = st.lists(st.sampled_from(PLACES), max_size=2, unique=True).map(tuple)
    places = {name: Place(name, tokens=draw(st.integers(0, 2)), capacity=CAPACITY, resource=True) for name in PLACES}
    transitions = {}
    for number in range(draw(st.integers(2, 6))):
        inputs = {draw(st.sampled_from(PLACES)): 1, **draw(arcs)}
        limits = {name: weight + 1 for name, weight in draw(arcs).items() if weight + 1 > inputs.get(name, 0)}
        acts = acting and draw(st.booleans())
        transitions[f"t{number}"] = Transition(
            f"t{number}",
            inputs,
            draw(arcs),
            inhibitors=limits if draw(st.booleans()) else {},
            resets=draw(emptied) or ("a",) if number == 0 else draw(emptied),
            action=FunctionAction("act") if acts else None,
            on_failure={"a": 1} if acts else {},
        )
    return Net("n", places, transitions)


Vector = dict[str, int]


def enabled(t: Transition, marking: Vector) -> bool:
    return all(marking[p] >= w for p, w in t.inputs.items()) and all(marking[p] < w for p, w in t.inhibitors.items())


def fired(t: Transition, marking: Vector) -> Vector:
    """The definition: it takes its tokens, then empties places, then gives."""
    after = {place: count - t.inputs.get(place, 0) for place, count in marking.items()}
    after |= dict.fromkeys(t.resets, 0)
    return {place: count + t.outputs.get(place, 0) for place, count in after.items()}


def explored(net: Net) -> tuple[dict[tuple[int, ...], set[str]], dict[tuple[int, ...], list[tuple[int, ...]]], bool]:
    """All markings with what they enable and lead to, and whether all are within the capacities and not too many."""
    first = {name: place.tokens for name, place in net.places.items()}
    offers: dict[tuple[int, ...], set[str]] = {}
    leads: dict[tuple[int, ...], list[tuple[int, ...]]] = {}
    waiting = deque([first])
    while waiting:
        marking = waiting.popleft()
        key = tuple(marking.values())
        if key in offers:
            continue
        if max(key) > CAPACITY or len(offers) > MOST:
            return offers, leads, False
        offers[key] = {name for name, t in net.transitions.items() if enabled(t, marking)}
        then = [fired(net.transitions[name], marking) for name in offers[key]]
        leads[key] = [tuple(each.values()) for each in then]
        waiting.extend(then)
    return offers, leads, True


def reach(goal: set[tuple[int, ...]], leads: dict[tuple[int, ...], list[tuple[int, ...]]]) -> set[tuple[int, ...]]:
    found = set(goal)
    while more := {key for key, after in leads.items() if key not in found and not found.isdisjoint(after)}:
        found |= more
    return found


@settings(max_examples=60, deadline=None)
@given(nets())
def test_verification_finds_what_the_definition_says(net):
    offers, leads, within = explored(net)
    report = verify([net], SearchLimits(states=20_000, seconds=1.0))
    if not within:
        assert not report.ok
        assert {case.kind for case in report.refusals} <= {"growth", "overflow", "deadlock"}
        return
    ever = set().union(*offers.values())
    assert report.bounded
    assert report.states == len(offers)
    assert report.labelled_arcs == sum(map(len, offers.values()))
    assert report.place_bounds == {name: max(key[i] for key in offers) for i, name in enumerate(PLACES)}
    assert report.has_deadlock == any(not each for each in offers.values())
    assert set(report.never_enabled) == net.transitions.keys() - ever
    for flow in report.p_semiflows:
        assert len({sum(flow.get(name, 0) * key[i] for i, name in enumerate(PLACES)) for key in offers}) == 1
    if report.live is not None:
        always = [reach({key for key in offers if name in offers[key]}, leads) == set(offers) for name in ever]
        assert report.live == (len(always) == len(net.transitions) and all(always))
        assert report.live_transitions == sum(always)


@settings(max_examples=60, deadline=None)
@given(nets())
def test_decision_diagrams_find_what_the_definition_says(net):
    offers, leads, within = explored(net)
    if not within or len(offers) < 4:
        return
    report = verify([net], SearchLimits(states=2, seconds=5.0))
    if report.states is not None:
        assert report.states == len(offers)
    if report.live is not None and report.bounded:
        ever = set().union(*offers.values())
        always = [reach({key for key in offers if name in offers[key]}, leads) == set(offers) for name in ever]
        assert report.live == (len(always) == len(net.transitions) and all(always))


@settings(max_examples=60, deadline=None)
@given(nets(acting=True), st.integers(0, 9))
def test_the_engine_fires_as_the_definition_says(net, seed):
    def act(ctx: ActionContext) -> None:
        if len(process.recorder.firings) % 3 == 0:
            raise NetError("no")

    process = Process([net], {"act": act}, seed=seed)
    executor, whole = process.exchange.nets["n"], expand(net)
    for _ in range(12):
        executor.pump(1)
    marking = {name: place.tokens for name, place in whole.places.items()}
    ends = {Phase.START: ".start", Phase.FAILED: ".failed"}
    for firing in process.recorder.firings:
        acts = net.transitions[firing.transition].action is not None
        name = firing.transition + (ends.get(firing.phase, ".end") if acts else "")
        assert enabled(whole.transitions[name], marking), name
        marking = fired(whole.transitions[name], marking)
    assert executor.marking() == {place: count for place, count in marking.items() if count}


COUNTER = """
net: counter
commands: {scan: {}}
rest: [ready, missed, free]
places:
  ready: {tokens: 2, resource: true}
  scanned:
  missed: {capacity: 2, resource: true}
  free: {tokens: 2, capacity: 2, resource: true}
  bad:
transitions:
  scan: {symbol: scan, in: ready, out: scanned, action: look, on_failure: bad}
  count: {in: [bad, free], out: [missed, ready], emit: scan_failed}
  too_often: {in: bad, inhibitors: {free: 1}, out: [ready, free, free], resets: missed, emit: scan_failed}
  good: {in: scanned, out: {ready: 1, free: 2}, resets: [missed, free], emit: scan_done}
"""


def test_a_counter_of_misses_begins_anew_with_a_success():
    net = parse_net(COUNTER)
    report = verify_to_load([net])
    report.require_ok()
    assert report.ok
    misses = iter([True, False, True, True, True])

    def look(ctx: ActionContext) -> None:
        if next(misses):
            raise NetError("missed")

    process = Process([net], {"look": look})
    shown = []
    for _ in range(5):
        process.command("counter", "scan")
        shown.append(process.marking("counter").get("missed", 0))
    assert shown == [1, 0, 1, 2, 0]
    assert [result.error is None for result in process.results] == [False, True, False, False, False]


def test_two_commands_do_not_lose_their_tokens_to_each_other():
    process = Process([parse_net(COUNTER)], {"look": lambda ctx: None})
    executor = process.exchange.nets["counter"]
    for _ in range(6):
        process.command("counter", "scan")
    assert [result.error for result in process.results] == [None] * 6
    assert executor.marking() == {"ready": 2, "free": 2}


def test_what_empties_is_the_only_way_to_lose_what_it_empties():
    assert "free" in resource_places(parse_net(COUNTER))
    derived = """
net: derived
places: {tool: 1, used: {capacity: 1, resource: true}, idle: {tokens: 1, resource: true}}
transitions:
  take: {symbol: s, in: [idle, tool], out: [idle, used]}
  give: {symbol: g, in: [idle, used], out: [idle, tool]}
  drop: {symbol: d, in: idle, out: idleRESETS}
"""
    assert "tool" in resource_places(parse_net(derived.replace("RESETS", "")))
    assert "tool" not in resource_places(parse_net(derived.replace("RESETS", ", resets: used")))


@pytest.mark.parametrize(
    ("changed", "by", "sentence"),
    [
        ("resets: missed", "resets: misssed", "there is no place 'misssed' (did you mean 'missed'?)"),
        ("resets: missed", "resets: bad", "'bad' may hold what belongs to a command; it must be `resource: true`"),
        ("missed: {capacity: 2", "missed: {remote: true, capacity: 2", "and not `remote`"),
        ("missed: {capacity: 2, resource: true}", "missed: {resource: true}", "'missed' must have a `capacity`"),
        ("resets: missed", "resets: [missed, missed]", "names a place twice"),
        ("missed: {capacity: 2", "missed: {capacity: 256", "in 257 ways together; at most 256"),
    ],
)
def test_what_cannot_be_emptied_is_refused_in_a_sentence(changed, by, sentence):
    with pytest.raises(NetFileError) as refused:
        parse_net(COUNTER.replace(changed, by), "counter.yaml")
    assert sentence in refused.value.message
    assert refused.value.message.startswith("counter.yaml:")
    assert ".resets" in refused.value.message


def test_a_place_that_is_emptied_keeps_its_capacity_or_the_net_is_refused():
    report = verify([parse_net(COUNTER.replace("free: {tokens: 2, capacity: 2", "free: {tokens: 3, capacity: 3"))])
    assert any("place missed gets 3 tokens, more than its capacity of 2" in case.reason for case in report.refusals)


def test_a_place_over_its_capacity_is_refused_where_only_decision_diagrams_find_it():
    rings = [f"  go{i}: {{in: a{i}, out: b{i}}}\n  come{i}: {{in: b{i}, out: a{i}}}\n" for i in range(12)]
    places = ", ".join(f"a{i}: 1, b{i}: " for i in range(12))
    text = f"net: rings\nplaces: {{{places}, x: 2, y: {{capacity: 1}}}}\ntransitions:\n{''.join(rings)}"
    text += "  lift: {in: x, out: y}\n  drop: {in: y, out: x}\n"
    report = verify([parse_net(text)], SearchLimits(states=3, seconds=20.0))
    assert not report.ok
    assert any("place y gets 2 tokens, more than its capacity of 1" in case.reason for case in report.refusals)


def test_resets_and_inhibitors_have_the_markings_of_the_definition():
    net = parse_net("""
net: closed
places: {a: 1, b: , c: {capacity: 2, resource: true}}
transitions:
  go: {in: a, out: [b, c], inhibitors: {c: 2}}
  back: {in: b, out: a}
  wipe: {in: a, out: a, resets: c}
""")
    assert verify([net]).states == len(explored_of(net))


def explored_of(net: Net) -> set[tuple[int, ...]]:
    found: set[tuple[int, ...]] = set()
    waiting = deque([{name: place.tokens for name, place in net.places.items()}])
    while waiting:
        marking = waiting.popleft()
        if tuple(marking.values()) not in found:
            found.add(tuple(marking.values()))
            waiting.extend(fired(t, marking) for t in net.transitions.values() if enabled(t, marking))
    return found


def test_time_is_told_of_actions_that_empty_and_refused_of_waits_that_do():
    net = parse_net(COUNTER.replace("action: look", "action: look, resets: missed, delay: 2"))
    timed = timed_net([net])
    assert [timer.name for timer in timed.timers] == ["scan"]
    times = [firing.time for firing in simulate([net], seed=random.Random(1).randrange(9), steps=60)]
    assert times[-1] > 10.0
    with pytest.raises(NetError, match="transition good has a delay and resets places"):
        timed_net([parse_net(COUNTER.replace("resets: [missed, free]", "resets: [missed, free], delay: 3"))])


def test_it_is_written_and_read_back():
    net = parse_net(COUNTER)
    assert parse_net(yaml_text(net)).transitions["good"].resets == ("missed", "free")


def test_what_was_emptied_is_empty_when_the_process_comes_back():
    files, misses = MemoryFiles("x"), iter([True, False])

    def look(ctx: ActionContext) -> None:
        if next(misses):
            raise NetError("missed")

    alive = JournalledProcess("x", [parse_net(COUNTER)], files, actions={"look": look})
    shown = []
    for number in (1, 2):
        alive.exchange.nets["counter"].command(Command(number, "scan", {}), lambda result: None)
        alive.turn()
        files = files.reborn()
        alive = JournalledProcess("x", [parse_net(COUNTER)], files, actions={"look": look})
        shown.append(alive.exchange.nets["counter"].marking())
    assert shown == [{"ready": 2, "missed": 1, "free": 1}, {"ready": 2, "free": 2}]
