"""Every answer of the report, against generated nets of known size and a search written from the definitions."""

from math import comb
from time import sleep

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.model.compiled import compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt.netfile import parse_net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.report import ANSWERS, Report
from im_pnt_analysis.verify.verdict import verify


def net_of(name: str, tokens: dict[str, int], arcs: dict[str, tuple[dict[str, int], dict[str, int]]]) -> Net:
    return Net(
        name,
        {place: Place(place, count) for place, count in tokens.items()},
        {t: Transition(t, taken, given, origin=t) for t, (taken, given) in arcs.items()},
    )


@pytest.mark.parametrize(("servers", "most"), [("1", 1), ("2", 2), ("inf", 3)])
def test_servers_bound_the_actions_under_way(servers, most):
    text = "net: n\nplaces: {a: 3}\ntransitions: {t: {in: a, out: a, action: f, on_failure: a, servers: %s}}"
    report = verify([parse_net(text % servers)])
    assert report.place_bounds["t.active"] == most
    assert report.live


def philosophers(count: int) -> Net:
    """Each takes either fork first: 3^n markings and two deadlocks."""
    tokens, arcs = {}, {}
    for i in range(count):
        right, left = f"fork{i}", f"fork{(i + 1) % count}"
        tokens |= {f"think{i}": 1, f"fork{i}": 1, f"right{i}": 0, f"left{i}": 0, f"eat{i}": 0}
        arcs |= {
            f"take_right{i}": ({f"think{i}": 1, right: 1}, {f"right{i}": 1}),
            f"take_left{i}": ({f"think{i}": 1, left: 1}, {f"left{i}": 1}),
            f"then_left{i}": ({f"right{i}": 1, left: 1}, {f"eat{i}": 1}),
            f"then_right{i}": ({f"left{i}": 1, right: 1}, {f"eat{i}": 1}),
            f"end{i}": ({f"eat{i}": 1}, {f"think{i}": 1, right: 1, left: 1}),
        }
    return net_of("philosophers", tokens, arcs)


def kanban(cards: int) -> Net:
    """Four cells (Ciardo and Tilgner, 1996)."""
    tokens, arcs = {}, {}
    for i in range(1, 5):
        tokens |= {f"card{i}": cards, f"work{i}": 0, f"bad{i}": 0, f"out{i}": 0}
        arcs |= {
            f"ok{i}": ({f"work{i}": 1}, {f"out{i}": 1}),
            f"redo{i}": ({f"work{i}": 1}, {f"bad{i}": 1}),
            f"back{i}": ({f"bad{i}": 1}, {f"work{i}": 1}),
        }
    arcs |= {
        "in": ({"card1": 1}, {"work1": 1}),
        "fork": ({"out1": 1, "card2": 1, "card3": 1}, {"card1": 1, "work2": 1, "work3": 1}),
        "join": ({"out2": 1, "out3": 1, "card4": 1}, {"card2": 1, "card3": 1, "work4": 1}),
        "leave": ({"out4": 1}, {"card4": 1}),
    }
    return net_of("kanban", tokens, arcs)


def ring(places: int, tokens: int) -> Net:
    """Tokens that go round: (tokens + places - 1 choose tokens) markings."""
    marking = {f"p{i}": tokens if i == 0 else 0 for i in range(places)}
    return net_of("ring", marking, {f"t{i}": ({f"p{i}": 1}, {f"p{(i + 1) % places}": 1}) for i in range(places)})


@pytest.mark.parametrize("count", [2, 3, 5, 8])
def test_philosophers(count):
    report = verify([philosophers(count)])
    assert report.states == 3**count
    assert (report.has_deadlock, report.deadlock_states, report.terminal_sccs) == (True, 2, 2)
    assert (report.live, report.live_transitions, report.quasi_live, report.reversible) == (False, 0, True, False)
    assert (report.safe, report.max_token_in_place, report.max_token_per_marking) == (True, 1, 2 * count)
    assert len(report.refusals[0].sequence) == count
    assert "siphon" in report.refusals[0].reason


def test_a_net_that_can_die_is_not_reversible_however_it_may_grow():
    net = net_of("n", {"a": 1, "b": 0, "c": 0}, {"grow": ({"a": 1}, {"a": 1, "c": 1}), "die": ({"a": 1}, {"b": 1})})
    report = verify([net])
    assert (report.has_deadlock, report.live, report.reversible) == (True, False, False)
    dead = verify([net_of("n", {"a": 1, "b": 0}, {"never": ({"b": 1}, {"a": 1})})])
    assert (dead.has_deadlock, dead.live, dead.reversible) == (True, False, True)


@pytest.mark.parametrize(("cards", "states"), [(1, 160), (2, 4600), (3, 58400)])
def test_kanban(cards, states):
    report = verify([kanban(cards)])
    assert report.ok
    assert report.states == states
    assert (report.live_transitions, report.reversible, report.terminal_sccs) == (16, True, 1)
    assert report.place_bounds == dict.fromkeys(kanban(1).places, cards)
    assert report.max_token_per_marking == 4 * cards


@pytest.mark.parametrize(
    ("places", "tokens", "states"), [(3, 10**2, 5151), (2, 3000, 3001), (40, 2, 820), (70, 1, 70), (130, 2, 8515)]
)
def test_rings_narrow_wide_and_of_several_words(places, tokens, states):
    report = verify([ring(places, tokens)])
    assert report.ok
    assert report.states == states
    assert report.max_token_per_marking == tokens


def test_numbers_stay_exact_beyond_a_word():
    big = 3 * 10**9
    net = net_of("big", {"a": 2 * big, "b": 0, "c": 1}, {"t": ({"a": big}, {"b": big}), "u": ({"b": big}, {"a": big})})
    report = verify([net])
    assert report.ok
    assert (report.states, report.place_bounds, report.max_token_per_marking) == (
        3,
        {"a": 2 * big, "b": 2 * big, "c": 1},
        2 * big + 1,
    )
    huge = net_of("huge", {"a": 10**30, "b": 0}, {"t": ({"a": 10**30}, {"b": 1})})
    report = verify([huge], SearchLimits(seconds=600.0))
    assert report.states == 2
    assert report.max_token_in_place == 10**30


def test_the_limit_is_cpu_time_so_that_a_busy_computer_makes_an_answer_late_and_not_missing():
    report = verify([philosophers(3)], SearchLimits(seconds=1.0), progress=lambda _: sleep(0.6))
    assert report.time_s > 1.0
    assert report.has_deadlock is not None
    assert not report.unknown.keys() & {"bounded", "states", "has_deadlock"}


def test_what_the_limits_do_not_permit_is_null_with_a_reason():
    report = verify([ring(30, 30)], SearchLimits(states=2_000, seconds=0.0), structure=True)
    assert report.bounded
    assert report.states is None
    for answer in ANSWERS:
        assert (getattr(report, answer) is None) == (answer in report.unknown)
        assert (getattr(report, answer) is None) != (answer in report.methods)
    assert not report.ok


def test_spaces_too_large_to_list_are_counted_all_the_same():
    report = verify([ring(30, 30)], SearchLimits(states=2_000))
    assert report.ok
    assert report.states == comb(59, 30)
    report = verify([philosophers(20)], SearchLimits(states=20_000))
    assert (report.states, report.deadlock_states, len(report.refusals[0].sequence)) == (3**20, 2, 20)


def test_two_firings_to_the_same_marking_are_one_edge_and_a_loop_is_one_too():
    net = net_of(
        "n",
        {"a": 1, "b": 0},
        {
            "t": ({"a": 1}, {"b": 1}),
            "u": ({"a": 1}, {"b": 1}),
            "loop": ({"a": 1}, {"a": 1}),
            "back": ({"b": 1}, {"a": 1}),
        },
    )
    report = verify([net])
    assert (report.labelled_arcs, report.distinct_edges) == (4, 3)


arcs = st.dictionaries(st.integers(0, 4), st.integers(1, 3), max_size=3)
specs = st.tuples(
    st.lists(st.integers(0, 3), min_size=2, max_size=5),
    st.lists(st.tuples(arcs, arcs, arcs), min_size=1, max_size=6),
)


def built(spec) -> Net:
    tokens, rows = spec

    def named(row, least=0):
        return {f"p{i}": weight + least for i, weight in row.items() if i < len(tokens)}

    return Net(
        "random",
        {f"p{i}": Place(f"p{i}", count) for i, count in enumerate(tokens)},
        {
            f"t{i}": Transition(f"t{i}", named(taken), named(given), inhibitors=named(stop, 1), origin=f"t{i}")
            for i, (taken, given, stop) in enumerate(rows)
        },
    )


class Reference:
    """The reachability graph by the definition, with dictionaries; ``over`` if it has more than ``cap`` markings."""

    def __init__(self, net: Net, cap: int) -> None:
        self.net, self.names = net, list(net.places)
        first = tuple(place.tokens for place in net.places.values())
        self.arcs: dict[tuple[int, ...], list[tuple[str, tuple[int, ...]]]] = {}
        self.distance = {first: 0}
        queue = [first]
        self.over = False
        for marking in queue:
            self.arcs[marking] = list(self.firings(marking))
            for _, after in self.arcs[marking]:
                if after not in self.distance:
                    self.distance[after] = self.distance[marking] + 1
                    queue.append(after)
            if len(queue) > cap:
                self.over = True
                return

    def firings(self, marking):
        at = dict(zip(self.names, marking, strict=True))
        for t in self.net.transitions.values():
            if all(at[p] >= w for p, w in t.inputs.items()) and all(at[p] < w for p, w in t.inhibitors.items()):
                yield t.name, tuple(at[p] - t.inputs.get(p, 0) + t.outputs.get(p, 0) for p in self.names)

    def reach(self, start) -> set[tuple[int, ...]]:
        known, stack = {start}, [start]
        while stack:
            for _, after in self.arcs[stack.pop()]:
                if after not in known:
                    known.add(after)
                    stack.append(after)
        return known

    def answers(self) -> dict[str, object]:
        reach = {marking: self.reach(marking) for marking in self.arcs}
        fireable = {m: {t for other in reach[m] for t, _ in self.arcs[other]} for m in self.arcs}
        first = next(iter(self.arcs))
        live = set.intersection(*fireable.values())
        dead = [m for m in self.arcs if not self.arcs[m]]
        terminal = {frozenset(reach[m]) for m in self.arcs if all(m in reach[other] for other in reach[m])}
        bounds = {p: max(m[i] for m in self.arcs) for i, p in enumerate(self.names)}
        never = [t for t in self.net.transitions if t not in fireable[first]]
        return {
            "states": len(self.arcs),
            "labelled_arcs": sum(map(len, self.arcs.values())),
            "distinct_edges": sum(len({after for _, after in row}) for row in self.arcs.values()),
            "place_bounds": bounds,
            "max_token_in_place": max(bounds.values()),
            "max_token_per_marking": max(map(sum, self.arcs)),
            "bounded": True,
            "safe": max(bounds.values()) <= 1,
            "has_deadlock": bool(dead),
            "deadlock_states": len(dead),
            "live": len(live) == len(self.net.transitions),
            "live_transitions": len(live),
            "quasi_live": not never,
            "never_enabled": never,
            "never_enabled_transitions": len(never),
            "reversible": all(first in found for found in reach.values()),
            "terminal_sccs": len(terminal),
            "resources_return": not dead
            and all(any(other[i] >= first[i] for other in reach[m]) for m in self.arcs for i in range(len(self.names))),
        }


def replayed(net: Net, report: Report, times: int = 1) -> tuple[int, ...]:
    compiled = compile_net(net)
    marking = compiled.marking_vector(net.initial_marking())
    refusal = report.refusals[0]
    for name in refusal.sequence + times * refusal.repeat:
        transition = compiled.transitions.index(name)
        assert compiled.enabled(marking, transition)
        marking = compiled.fire(marking, transition)
    if times == 1:
        assert compiled.marking(marking) == refusal.marking
    return marking


@settings(max_examples=50, deadline=None)
@given(specs)
def test_every_answer_agrees_with_the_definition(spec):
    net = built(spec)
    reference = Reference(net, 150)
    # a search that the computer's speed may end decides nothing below; one of 150 markings ends by itself
    report = verify([net], SearchLimits(states=1_000, seconds=0.2 if reference.over else 60.0))
    if report.refusals:
        replayed(net, report)
    if reference.over:
        assert report.states is None or report.states > 150
        return
    expected = reference.answers()
    if expected["has_deadlock"]:
        expected["resources_return"] = None
        dead = [m for m in reference.arcs if not reference.arcs[m]]
        assert len(report.refusals[0].sequence) == min(reference.distance[m] for m in dead)
    assert {name: getattr(report, name) for name in expected} == expected
    assert report.ok == (report.resources_return is True)


@settings(max_examples=50, deadline=None)
@given(specs)
def test_growth_can_be_repeated_for_ever(spec):
    net = built(spec)
    report = verify([net], SearchLimits(states=1_000, seconds=0.2))
    if report.bounded is False:
        assert Reference(net, 2_000).over
        assert report.refusals[0].repeat
        totals = [sum(replayed(net, report, times)) for times in (1, 2, 5, 9)]
        assert totals == sorted(set(totals))
    elif report.bounded:
        assert report.states is None or not Reference(net, report.states).over


@pytest.mark.parametrize(("tokens", "why"), [("", "; u waits for permit, which nothing marks"), ("1", "; siphon {")])
def test_a_deadlock_names_a_place_that_nothing_marks(tokens, why):
    net = parse_net(
        f"net: n\nplaces: {{a: 1, b: , permit: {tokens}, c: }}\ntransitions:\n"
        "  t: {symbol: go, in: a, out: b}\n  u: {in: [b, permit], out: c}\n  v: {in: c, out: a, emit: go_done}"
    )
    assert why in verify([net]).refusals[0].reason
