"""The explicit search in each of its ways: marking by marking, many at a time, of one word and of several."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.search import digraph, packing
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.search.reachability_graph import ReachabilityGraph

_LARGEST = 300

arcs = st.dictionaries(st.integers(0, 4), st.integers(1, 5), max_size=3)
specs = st.tuples(
    st.lists(st.integers(0, 7), min_size=2, max_size=5),
    st.lists(st.tuples(arcs, arcs, arcs), min_size=1, max_size=6),
)


def built(spec, padding: int) -> Net:
    """A random net, each transition of which also moves a token of some further places to and fro."""
    tokens, rows = spec

    def named(row, least=0):
        return {f"p{i}": weight + least for i, weight in row.items() if i < len(tokens)}

    places = {f"p{i}": Place(f"p{i}", count) for i, count in enumerate(tokens)}
    places |= {f"pad{i}": Place(f"pad{i}", 3) for i in range(padding)}
    pad = {f"pad{i}": 2 for i in range(padding)}
    transitions = {
        f"t{i}": Transition(f"t{i}", named(taken) | pad, named(given) | pad, inhibitors=named(stop, 1), origin=f"t{i}")
        for i, (taken, given, stop) in enumerate(rows)
    }
    for i in range(min(padding, 2)):
        transitions[f"out{i}"] = Transition(f"out{i}", {f"pad{i}": 3}, {f"pad{i + 2}": 3}, origin=f"out{i}")
    return Net("random", places, transitions)


def reference(compiled: Compiled, initial: tuple[int, ...]) -> dict[tuple[int, ...], int] | None:
    """Reachable markings and their distances; None where there are too many."""
    distance = {initial: 0}
    queue = [initial]
    for marking in queue:
        for transition in range(len(compiled.transitions)):
            if compiled.enabled(marking, transition):
                after = compiled.fire(marking, transition)
                if after not in distance:
                    distance[after] = distance[marking] + 1
                    queue.append(after)
        if len(queue) > _LARGEST:
            return None
    return distance


def searched(net: Net) -> tuple[Search, Compiled, tuple[int, ...]]:
    compiled = compile_net(net)
    initial = compiled.marking_vector(net.initial_marking())
    search = Search(compiled, initial)
    search.run(SearchLimits(states=_LARGEST + 2_000), thread_cpu() + 600.0)
    return search, compiled, initial


@pytest.mark.parametrize("padding", [0, 40])
@pytest.mark.parametrize("weak", [False, True])
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(spec=specs)
def test_all_markings_are_found_by_shortest_ways(spec, padding, weak, monkeypatch):
    if weak:
        strong = packing._hash
        monkeypatch.setattr(packing, "_hash", lambda n, attempt: strong(n, attempt) if attempt else [1] * n)
    try:
        search, compiled, initial = searched(built(spec, padding))
    finally:
        monkeypatch.undo()
    expected = reference(compiled, initial)
    if expected is None:
        assert search.found.count > _LARGEST
        return
    assert search.complete
    found = [search.found.vector(number) for number in range(search.found.count)]
    assert set(found) == set(expected)
    assert len(found) == len(expected)
    assert all(expected[a] <= expected[b] for a, b in pairwise(found))
    for number, vector in enumerate(found):
        marking = initial
        sequence = search.found.sequence(number)
        assert len(sequence) == expected[vector]
        for name in sequence:
            assert compiled.enabled(marking, compiled.transitions.index(name))
            marking = compiled.fire(marking, compiled.transitions.index(name))
        assert marking == vector
    begins, targets = search.found.arcs()
    for number, vector in enumerate(found):
        fired = {compiled.fire(vector, t) for t in range(len(compiled.transitions)) if compiled.enabled(vector, t)}
        after = [found[target] for target in targets[begins[number] : begins[number + 1]]]
        assert set(after) == fired - {vector}
        assert len(after) == len(set(after))


@settings(max_examples=50, deadline=None)
@given(st.integers(1, 40).flatmap(lambda n: st.lists(st.tuples(*[st.integers(0, n - 1)] * 2), max_size=80)))
def test_components_agree_whatever_the_size(edges):
    nodes = 1 + max((max(edge) for edge in edges), default=0)
    rows = [sorted({b for a, b in edges if a == node}) for node in range(nodes)]
    begins = np.cumsum([0, *map(len, rows)])
    targets = np.array([b for row in rows for b in row], np.int32)
    goal = np.arange(nodes) % 3 == 0
    small, reach = digraph.components(begins, targets), digraph.reaching(begins, targets, goal)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(digraph, "_SMALL", -1)
        large, reached = digraph.components(begins, targets), digraph.reaching(begins, targets, goal)
    assert small.count == large.count
    assert len(set(zip(small.label, large.label, strict=True))) == small.count
    assert all(small.terminal[small.label] == large.terminal[large.label])
    assert all(reach == reached)


def test_a_search_goes_on_where_it_stopped():
    places = {name: Place(name, tokens) for name, tokens in (("a", 300), ("b", 0), ("c", 0))}
    transitions = {
        f"t{i}": Transition(f"t{i}", {a: 1}, {b: 1}, origin=f"t{i}") for i, (a, b) in enumerate(("ab", "bc", "ca"))
    }
    compiled = compile_net(Net("ring", places, transitions))
    search = Search(compiled, (300, 0, 0))
    counts = []
    for states in (10, 500, 5_000, 100_000):
        search.run(SearchLimits(states=states), thread_cpu() + 600.0)
        counts.append(search.found.count)
    assert counts[0] < counts[1] < counts[2] < counts[3] == 301 * 302 // 2
    assert search.complete
    assert ReachabilityGraph(search).reversible
