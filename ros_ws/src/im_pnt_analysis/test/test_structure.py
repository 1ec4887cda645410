from itertools import combinations

from hypothesis import given, settings
from hypothesis import strategies as st

from bench.nets.families import catching_philosophers, kanban
from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.search.coverability import coverability
from im_pnt_analysis.search.stubborn import find_deadlock, search
from im_pnt_analysis.structure.reduction import reduce_for_deadlock
from im_pnt_analysis.structure.siphons import emptied_siphon, siphons, traps
from im_pnt_analysis.structure.state_equation import structurally_bounded

Vector = tuple[int, ...]
MOST = 150


@st.composite
def nets(draw, *, inhibited: bool = True, growing: bool = True) -> Compiled:
    """Small nets with weights, sources, sinks and self-loops."""
    names = [f"p{i}" for i in range(draw(st.integers(1, 5)))]
    arcs = st.dictionaries(st.sampled_from(names), st.sampled_from([1, 1, 1, 2]), max_size=3)
    transitions = {}
    for i in range(draw(st.integers(1, 6))):
        inputs, outputs = draw(arcs), draw(arcs)
        while not growing and sum(outputs.values()) > sum(inputs.values()):
            outputs.popitem()
        tests = st.dictionaries(st.sampled_from(names), st.integers(1, 3), max_size=1)
        inhibitors = draw(tests) if inhibited and draw(st.integers(0, 3)) == 0 else {}
        transitions[f"t{i}"] = Transition(f"t{i}", inputs, outputs, inhibitors=inhibitors, origin=f"t{i}")
    return compile_net(Net("n", {name: Place(name, draw(st.integers(0, 2))) for name in names}, transitions))


def initial(compiled: Compiled) -> Vector:
    return compiled.marking_vector(compiled.net.initial_marking())


def listed(compiled: Compiled) -> tuple[list[Vector], bool]:
    """The reachable markings by the definition, and whether these are all."""
    found = {initial(compiled): None}
    for vector in (queue := list(found)):
        for transition in range(len(compiled.transitions)):
            if compiled.enabled(vector, transition) and (after := compiled.fire(vector, transition)) not in found:
                found[after] = None
                queue.append(after)
        if len(found) > MOST:
            return queue, False
    return queue, True


def fired(compiled: Compiled, vector: Vector, names) -> Vector:
    for name in names:
        transition = compiled.transitions.index(name)
        assert compiled.enabled(vector, transition), f"{name} is not enabled"
        vector = compiled.fire(vector, transition)
    return vector


def is_dead(compiled: Compiled, vector: Vector) -> bool:
    return not any(compiled.enabled(vector, t) for t in range(len(compiled.transitions)))


@settings(max_examples=40, deadline=None)
@given(nets())
def test_structurally_bounded_nets_are_bounded_from_any_marking(compiled):
    if structurally_bounded(compiled):
        assert coverability(compiled, initial(compiled), max_nodes=500).bounded in (True, None)


@settings(max_examples=40, deadline=None)
@given(nets(inhibited=False))
def test_structural_boundedness_is_decided_on_small_nets(compiled):
    if not structurally_bounded(compiled):
        many = tuple(60 for _ in compiled.places)
        assert coverability(compiled, many, max_nodes=500).bounded in (False, None)


def test_large_nets_and_huge_arcs_are_decided_and_a_place_that_grows_is_found():
    assert structurally_bounded(compile_net(kanban(7)))
    grown = compile_net(Net("n", {"a": Place("a")}, {"t": Transition("t", outputs={"a": 1}, origin="t")}))
    assert not structurally_bounded(grown)
    huge = Transition("t", {"a": 10**30}, {"b": 10**29}, origin="t")
    assert structurally_bounded(compile_net(Net("n", {"a": Place("a"), "b": Place("b")}, {"t": huge})))


def is_siphon(compiled: Compiled, places: set[int], forward: bool) -> bool:
    for takes, gives in zip(compiled.inputs, compiled.outputs, strict=True):
        takes, gives = {p for p, _ in takes}, {p for p, _ in gives}
        if not forward:
            takes, gives = gives, takes
        if places & gives and not places & takes:
            return False
    return True


def all_siphons(compiled: Compiled) -> list[set[int]]:
    everything = range(len(compiled.places))
    sets = [set(c) for size in everything for c in combinations(everything, size + 1)]
    return [places for places in sets if is_siphon(compiled, places, forward=True)]


@settings(max_examples=40, deadline=None)
@given(nets(), st.booleans())
def test_siphons_and_traps_are_the_minimal_ones_of_all_sets(compiled, forward):
    everything = range(len(compiled.places))
    sets = [set(c) for size in everything for c in combinations(everything, size + 1)]
    good = [places for places in sets if is_siphon(compiled, places, forward)]
    smallest = {tuple(compiled.places[p] for p in sorted(s)) for s in good if not any(other < s for other in good)}
    found = (siphons if forward else traps)(compiled)
    assert found.complete
    assert set(found.sets) == smallest
    assert len(found.sets) == len(smallest)


@settings(max_examples=40, deadline=None)
@given(nets(inhibited=False))
def test_a_siphon_that_was_emptied_was_marked_and_stays_empty(compiled):
    first = initial(compiled)
    for vector in listed(compiled)[0]:
        emptied = {compiled.places.index(name) for name in emptied_siphon(compiled, first, vector)}
        assert is_siphon(compiled, emptied, forward=True)
        assert not any(vector[place] for place in emptied)
        lost = [s for s in all_siphons(compiled) if any(first[p] for p in s) and not any(vector[p] for p in s)]
        assert bool(emptied) == bool(lost)
        assert not emptied or emptied in lost


def test_siphons_stop_at_their_limit_and_in_time():
    compiled = compile_net(catching_philosophers(20))
    few = siphons(compiled, limit=5)
    assert (len(few.sets), few.complete, few.reason) == (5, False, "more than 5")
    none = siphons(compiled, deadline=thread_cpu() - 1.0)
    assert (none.complete, none.reason) == (False, "the time is up")


@settings(max_examples=40, deadline=None)
@given(nets())
def test_what_can_be_covered_agrees_with_the_listed_markings(compiled):
    markings, finite = listed(compiled)
    found = coverability(compiled, initial(compiled), max_nodes=500)
    most = {name: max(column) for name, column in zip(compiled.places, zip(*markings, strict=True), strict=True)}
    ever = {t for v in markings for t in range(len(compiled.transitions)) if compiled.enabled(v, t)}
    never = {name for t, name in enumerate(compiled.transitions) if t not in ever}
    if finite:
        assert (found.complete, found.bounded, found.unbounded_places) == (True, True, ())
        assert found.place_bounds == most
        assert found.max_token_per_marking == max(sum(v) for v in markings)
        assert set(found.never_enabled) == never
    elif found.complete:
        assert found.bounded is False
        assert set(found.never_enabled) <= never
        assert all(most[name] <= bound for name, bound in found.place_bounds.items())
    if found.bounded is False:
        vector = fired(compiled, initial(compiled), found.sequence)
        for _ in range(3):
            after = fired(compiled, vector, found.repeat)
            gained = [name for name, a, b in zip(compiled.places, vector, after, strict=True) if b > a]
            assert all(b >= a for a, b in zip(vector, after, strict=True))
            assert tuple(gained) == found.growing
            vector = after
        assert set(found.growing) <= set(found.unbounded_places)


@settings(max_examples=40, deadline=None)
@given(nets(inhibited=False))
def test_coverability_without_inhibitors_always_ends(compiled):
    found = coverability(compiled, initial(compiled), max_nodes=20_000)
    assert found.complete
    assert found.bounded == listed(compiled)[1] or found.bounded


def test_growth_is_found_behind_a_long_way():
    places = {f"p{i}": Place(f"p{i}", int(i == 0)) for i in range(60)} | {"grown": Place("grown")}
    steps = {f"t{i}": Transition(f"t{i}", {f"p{i}": 1}, {f"p{i + 1}": 1}, origin=f"t{i}") for i in range(59)}
    steps["grow"] = Transition("grow", {"p59": 1}, {"p59": 1, "grown": 2}, origin="grow")
    compiled = compile_net(Net("n", places, steps))
    found = coverability(compiled, initial(compiled))
    assert (found.unbounded_places, found.repeat, found.growing) == (("grown",), ("grow",), ("grown",))
    assert found.place_bounds == {f"p{i}": 1 for i in range(60)}
    assert len(found.sequence) == 59


def test_coverability_stops_at_its_limits():
    compiled = compile_net(kanban(5))
    assert coverability(compiled, initial(compiled), max_nodes=100).reason == "more than 100 markings"
    assert "time is up" in coverability(compiled, initial(compiled), deadline=thread_cpu() - 1.0).reason


@settings(max_examples=40, deadline=None)
@given(nets(growing=False), st.booleans())
def test_deadlocks_are_found_if_and_only_if_there_are_some(compiled, reduced):
    markings, finite = listed(compiled)
    dead = [vector for vector in markings if is_dead(compiled, vector)]
    found = (find_deadlock if reduced else search)(compiled, initial(compiled))
    assert not finite or found.found == bool(dead)
    assert not dead or found.found
    if found.found:
        assert fired(compiled, initial(compiled), found.sequence) == found.marking
        assert is_dead(compiled, found.marking)
    assert found.reason == ""


@settings(max_examples=40, deadline=None)
@given(nets())
def test_the_reduced_net_can_die_if_and_only_if_the_original_can(compiled):
    markings, finite = listed(compiled)
    reduced = reduce_for_deadlock(compiled, initial(compiled))
    assert len(reduced.compiled.places) <= len(compiled.places)
    smaller, smaller_finite = listed(compile_net(reduced.compiled.net))
    dead = any(is_dead(compiled, vector) for vector in markings)
    if finite and smaller_finite:
        assert dead == any(is_dead(reduced.compiled, vector) for vector in smaller)
