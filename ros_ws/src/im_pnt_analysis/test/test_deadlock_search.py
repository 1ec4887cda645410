import pytest

from bench.nets.families import catching_philosophers, kanban, ring
from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.search.stubborn import find_deadlock, search
from im_pnt_analysis.structure.reduction import reduce_for_deadlock
from im_pnt_analysis.structure.siphons import emptied_siphon


def start(net: Net) -> tuple[Compiled, tuple[int, ...]]:
    compiled = compile_net(net)
    return compiled, compiled.marking_vector(net.initial_marking())


def line(length: int) -> Net:
    """A token that goes along a line and stops."""
    places = {f"p{i}": Place(f"p{i}", int(i == 0)) for i in range(length + 1)}
    steps = {f"t{i}": Transition(f"t{i}", {f"p{i}": 1}, {f"p{i + 1}": 1}, origin=f"t{i}") for i in range(length)}
    return Net("line", places, steps)


@pytest.mark.parametrize("seats", [5, 20])
def test_philosophers_are_searched_in_far_fewer_markings_than_there_are(seats):
    compiled, first = start(catching_philosophers(seats))
    found = find_deadlock(compiled, first)
    assert found.found
    assert found.states_searched < 3 * seats**2
    assert not any(compiled.enabled(found.marking, t) for t in range(len(compiled.transitions)))
    forks = {name for name in emptied_siphon(compiled, first, found.marking) if name.startswith("fork")}
    assert forks


def test_kanban_reduces_to_next_to_nothing():
    found = find_deadlock(*start(kanban(50)))
    assert (found.found, found.reason) == (False, "")
    assert found.states_searched < 10


def test_a_line_reduces_and_its_whole_sequence_comes_back():
    compiled, first = start(line(100))
    assert len(reduce_for_deadlock(compiled, first).compiled.transitions) <= 1
    assert find_deadlock(compiled, first).sequence == compiled.transitions


def test_what_waits_for_its_partner_is_fired_at_the_end():
    go, meet = Transition("go", {"a": 1}, {"b": 1}, origin="go"), Transition("meet", {"b": 1, "c": 1}, origin="meet")
    places = {"a": Place("a", 3), "b": Place("b"), "c": Place("c", 1)}
    compiled, first = start(Net("n", places, {"go": go, "meet": meet}))
    found = find_deadlock(compiled, first)
    assert sorted(found.sequence) == ["go", "go", "go", "meet"]
    assert found.marking == (0, 2, 0)


def test_a_ring_never_dies_and_a_transition_without_inputs_keeps_any_net_alive():
    assert find_deadlock(*start(ring(50))).found is False
    net = line(3)
    source = Transition("source", outputs={"p0": 1}, origin="source")
    alive = Net("n", net.places, {**net.transitions, "source": source})
    assert find_deadlock(*start(alive)).found is False


def test_a_net_without_transitions_is_dead_at_once():
    found = find_deadlock(*start(Net("n", {"a": Place("a", 2)}, {})))
    assert (found.found, found.sequence, found.marking) == (True, (), (2,))


def test_the_search_stops_at_its_limits_and_says_so():
    compiled, first = start(catching_philosophers(40))
    few = search(compiled, first, max_states=20)
    assert (few.found, few.reason) == (None, "more than 20 markings")
    late = search(*start(kanban(9)), deadline=thread_cpu() - 1.0)
    assert late.found is None
    assert "time is up" in late.reason
