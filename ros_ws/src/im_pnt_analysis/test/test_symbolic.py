import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bench.nets.families import catching_philosophers, kanban, ring
from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.symbolic.exploration import explore
from im_pnt_analysis.symbolic.mdd import Diagram, deep_recursion
from im_pnt_analysis.symbolic.saturation import Saturation, saturation_event

Vector = tuple[int, ...]


@st.composite
def bounded_nets(draw) -> Net:
    """Small nets whose firings never add tokens; some arcs have weights, some inhibit."""
    names = [f"p{i}" for i in range(draw(st.integers(1, 5)))]
    arcs = st.dictionaries(st.sampled_from(names), st.integers(1, 2), max_size=3)
    transitions = {}
    for i in range(draw(st.integers(0, 6))):
        inputs, outputs = draw(arcs), draw(arcs)
        while sum(outputs.values()) > sum(inputs.values()):
            outputs.popitem()
        inhibitors = draw(st.dictionaries(st.sampled_from(names), st.integers(1, 3), max_size=1))
        transitions[f"t{i}"] = Transition(f"t{i}", inputs, outputs, inhibitors=inhibitors, origin=f"t{i}")
    return Net("n", {name: Place(name, draw(st.integers(0, 3))) for name in names}, transitions)


def reachable(compiled: Compiled, first: Vector) -> dict[Vector, list[tuple[int, Vector]]]:
    """Every reachable marking with its firings, by the definition."""
    graph: dict[Vector, list[tuple[int, Vector]]] = {}
    queue = [first]
    for vector in queue:
        if vector not in graph:
            fired = [t for t in range(len(compiled.transitions)) if compiled.enabled(vector, t)]
            graph[vector] = [(t, compiled.fire(vector, t)) for t in fired]
            queue.extend(after for _, after in graph[vector])
    return graph


def can_reach(graph, targets) -> set[Vector]:
    found = set(targets)
    while True:
        more = {v for v, arcs in graph.items() if v not in found and any(after in found for _, after in arcs)}
        if not more:
            return found
        found |= more


def distance(graph, first) -> dict[Vector, int]:
    steps = {first: 0}
    queue = [first]
    for vector in queue:
        for _, after in graph[vector]:
            if after not in steps:
                steps[after] = steps[vector] + 1
                queue.append(after)
    return steps


@settings(max_examples=60, deadline=None)
@given(bounded_nets())
def test_every_answer_is_that_of_the_listed_markings(net):
    compiled = compile_net(net)
    first = compiled.marking_vector(net.initial_marking())
    graph = reachable(compiled, first)
    assume(len(graph) < 2_000)
    found = explore(compiled, first)
    dead = [v for v, arcs in graph.items() if not arcs]
    firing = {t: [v for v, arcs in graph.items() if t in dict(arcs)] for t in range(len(compiled.transitions))}
    live = [compiled.transitions[t] for t, where in firing.items() if len(can_reach(graph, where)) == len(graph)]
    assert not found.unknown
    assert found.states == len(graph)
    assert list(found.place_bounds.values()) == [max(column) for column in zip(*graph, strict=True)]
    assert found.max_token_per_marking == max(sum(v) for v in graph)
    assert found.arcs == sum(len(arcs) for arcs in graph.values())
    assert found.distinct_edges == len({(v, after) for v, arcs in graph.items() for _, after in arcs})
    assert (found.has_deadlock, found.deadlock_states) == (bool(dead), len(dead))
    assert found.never_enabled == tuple(compiled.transitions[t] for t, where in firing.items() if not where)
    assert found.reversible == (len(can_reach(graph, [first])) == len(graph))
    assert found.live_transitions == tuple(live)
    assert found.live == (len(live) == len(compiled.transitions))
    if dead:
        steps = distance(graph, first)
        assert len(found.deadlock_sequence) == min(steps[v] for v in dead)
        vector = first
        for name in found.deadlock_sequence:
            transition = compiled.transitions.index(name)
            assert compiled.enabled(vector, transition)
            vector = compiled.fire(vector, transition)
        assert vector in dead
        assert compiled.marking(vector) == found.deadlock_marking


@settings(max_examples=50, deadline=None)
@given(st.data())
def test_operations_on_sets_are_those_of_sets(data):
    depth = data.draw(st.integers(1, 4))
    markings = st.sets(st.tuples(*[st.integers(0, 2)] * depth), min_size=1, max_size=12)
    a, b = data.draw(markings), data.draw(markings)
    diagram = Diagram(data.draw(st.permutations(range(depth))))

    def build(vectors: set[Vector]) -> int:
        node = 0
        for vector in vectors:
            node = diagram.union(node, diagram.single(vector))
        return node

    x, y = build(a), build(b)
    for node, expected in (
        (diagram.union(x, y), a | b),
        (diagram.intersection(x, y), a & b),
        (diagram.difference(x, y), a - b),
    ):
        assert node == build(expected)
        assert diagram.count(node) == len(expected)
        assert all(diagram.contains(node, vector) == (vector in expected) for vector in a | b)
        assert not expected or diagram.pick(node) in expected


@settings(max_examples=50, deadline=None)
@given(bounded_nets(), st.randoms(use_true_random=False))
def test_backward_search_stays_within_its_set_and_finds_all_of_it(net, random):
    compiled = compile_net(net)
    first = compiled.marking_vector(net.initial_marking())
    graph = reachable(compiled, first)
    assume(len(graph) < 500)
    within = set(random.sample(sorted(graph), random.randint(1, len(graph))))
    target = random.choice(sorted(within))
    inside = {v: [arc for arc in arcs if arc[1] in within] for v, arcs in graph.items() if v in within}
    diagram = Diagram(range(len(compiled.places)))
    allowed = 0
    for vector in within:
        allowed = diagram.union(allowed, diagram.single(vector))
    undone = [saturation_event(compiled, diagram, t, backward=True) for t in range(len(compiled.transitions))]
    found = Saturation(diagram, undone, within=allowed).close(diagram.single(target))
    expected = can_reach(inside, [target])
    assert diagram.count(found) == len(expected)
    assert all(diagram.contains(found, vector) for vector in expected)


@pytest.mark.parametrize(("cards", "states"), [(1, 160), (2, 4600), (3, 58400), (4, 454475), (10, 1_005_927_208)])
def test_kanban_has_the_published_number_of_states(cards, states):
    net = kanban(cards)
    compiled = compile_net(net)
    found = explore(compiled, compiled.marking_vector(net.initial_marking()))
    assert (found.states, found.has_deadlock, found.reversible, found.live) == (states, False, True, True)
    assert set(found.place_bounds.values()) == {cards}


@pytest.mark.parametrize("seats", [3, 20])
def test_philosophers_have_three_to_the_n_states_and_two_deadlocks(seats):
    net = catching_philosophers(seats)
    compiled = compile_net(net)
    found = explore(compiled, compiled.marking_vector(net.initial_marking()))
    assert (found.states, found.deadlock_states, len(found.deadlock_sequence)) == (3**seats, 2, seats)
    assert found.max_token_per_marking == 2 * seats
    assert (found.live, found.reversible) == (False, False)


def test_a_ring_is_as_long_as_it_is():
    net = ring(300)
    compiled = compile_net(net)
    found = explore(compiled, compiled.marking_vector(net.initial_marking()))
    assert (found.states, found.arcs, found.distinct_edges, found.live) == (300, 300, 300, True)


def test_it_gives_up_in_time_and_says_so():
    net = kanban(60)
    compiled = compile_net(net)
    found = explore(compiled, compiled.marking_vector(net.initial_marking()), deadline=thread_cpu())
    assert found.states is None
    assert "time is up" in found.unknown["states"]
    assert found.unknown.keys() >= {"states", "live", "reversible", "arcs", "place_bounds", "has_deadlock"}


def test_a_net_that_grows_without_end_is_given_up():
    net = Net("n", {"a": Place("a")}, {"t": Transition("t", outputs={"a": 1}, origin="t")})
    found = explore(compile_net(net), (0,))
    assert found.states is None
    assert "more than 10000 tokens" in found.unknown["states"]


def test_a_net_without_places_has_one_marking():
    assert explore(compile_net(Net("n", {}, {})), ()).states == 1


def test_deep_diagrams_leave_the_recursion_limit_as_it_was():
    import sys

    before = sys.getrecursionlimit()
    with deep_recursion(10_000):
        assert sys.getrecursionlimit() > before
    assert sys.getrecursionlimit() == before
