from fractions import Fraction
from itertools import combinations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.nets.families import catching_philosophers, kanban
from im_core.clock import thread_cpu
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.structure.semiflows import p_semiflows, t_semiflows


@st.composite
def nets(draw) -> Compiled:
    names = [f"p{i}" for i in range(draw(st.integers(1, 6)))]
    arcs = st.dictionaries(st.sampled_from(names), st.sampled_from([1, 1, 2, 3]), max_size=3)
    transitions = {
        f"t{i}": Transition(f"t{i}", draw(arcs), draw(arcs), origin=f"t{i}") for i in range(draw(st.integers(1, 6)))
    }
    return compile_net(Net("n", {name: Place(name) for name in names}, transitions))


def incidence(compiled: Compiled) -> list[list[int]]:
    """A row for each place, a column for each transition."""
    changes = [dict(pairs) for pairs in compiled.change]
    return [[change.get(place, 0) for change in changes] for place in range(len(compiled.places))]


def only_solution(rows: list[list[int]]) -> list[Fraction] | None:
    """The weighting w of rows with w . rows = 0, first weight 1, if there is exactly one, by Gauss' elimination."""
    equations = [[Fraction(value) for value in column] for column in zip(*rows, strict=True)]
    equations.append([Fraction(1)] + [Fraction(0)] * (len(rows) - 1))
    right = [Fraction(0)] * (len(equations) - 1) + [Fraction(1)]
    done = 0
    for unknown in range(len(rows)):
        pivot = next((i for i in range(done, len(equations)) if equations[i][unknown]), None)
        if pivot is None:
            return None
        equations[done], equations[pivot] = equations[pivot], equations[done]
        right[done], right[pivot] = right[pivot], right[done]
        for i in range(len(equations)):
            if i != done and equations[i][unknown]:
                factor = equations[i][unknown] / equations[done][unknown]
                equations[i] = [a - factor * b for a, b in zip(equations[i], equations[done], strict=True)]
                right[i] -= factor * right[done]
        done += 1
    if any(right[done:]):
        return None
    return [right[i] / equations[i][i] for i in range(len(rows))]


def minimal_flows(matrix: list[list[int]], names: tuple[str, ...]) -> set[frozenset[tuple[str, Fraction]]]:
    """All semiflows of minimal support, scaled so that the first weight is 1, by trying every support."""
    found: list[tuple[set[int], frozenset[tuple[str, Fraction]]]] = []
    for size in range(1, len(names) + 1):
        for support in combinations(range(len(names)), size):
            if any(other <= set(support) for other, _ in found):
                continue
            solution = only_solution([matrix[index] for index in support])
            if solution is not None and min(solution) > 0:
                pairs = zip((names[index] for index in support), solution, strict=True)
                found.append((set(support), frozenset(pairs)))
    return {flow for _, flow in found}


def scaled(flow: dict[str, int]) -> frozenset[tuple[str, Fraction]]:
    first = next(iter(flow.values()))
    return frozenset((name, Fraction(weight, first)) for name, weight in flow.items())


@settings(max_examples=80, deadline=None)
@given(nets())
def test_semiflows_are_all_of_minimal_support(compiled):
    matrix = incidence(compiled)
    turned = [list(column) for column in zip(*matrix, strict=True)]
    for found, rows, names in (
        (p_semiflows(compiled), matrix, compiled.places),
        (t_semiflows(compiled), turned, compiled.transitions),
    ):
        assert found.complete
        assert {scaled(flow) for flow in found.flows} == minimal_flows(rows, names)
        assert len({scaled(flow) for flow in found.flows}) == len(found.flows)


@settings(max_examples=50, deadline=None)
@given(nets())
def test_capped_semiflows_are_true_and_cover_what_can_be_covered(compiled):
    matrix = incidence(compiled)
    capped, whole = p_semiflows(compiled, max_rows=1), p_semiflows(compiled)
    for flow in capped.flows:
        weights = [flow.get(name, 0) for name in compiled.places]
        assert not any(sum(w * c for w, c in zip(weights, column, strict=True)) for column in zip(*matrix, strict=True))
    assert {name for flow in capped.flows for name in flow} == {name for flow in whole.flows for name in flow}
    assert capped.complete or "rows" in capped.reason


def choices(count: int) -> Compiled:
    """A token that passes count pairs of parallel ways: 2**count T-semiflows."""
    places = {f"p{i}": Place(f"p{i}", int(i == 0)) for i in range(count)}
    transitions = {}
    for i in range(count):
        for way in "ab":
            name = f"{way}{i}"
            transitions[name] = Transition(name, {f"p{i}": 1}, {f"p{(i + 1) % count}": 1}, origin=name)
    return compile_net(Net("n", places, transitions))


def test_very_many_semiflows_are_capped_and_still_cover():
    compiled = choices(40)
    found = t_semiflows(compiled, max_rows=200)
    assert not found.complete
    assert found.reason == "more than 200 rows of the working table"
    assert found.covers(compiled.transitions)
    assert all(len(flow) == 40 and set(flow.values()) == {1} for flow in found.flows)


def test_the_deadline_is_kept_and_said():
    found = p_semiflows(compile_net(kanban(3)), deadline=thread_cpu() - 1.0)
    assert (found.complete, found.reason) == (False, "the time is up")


@pytest.mark.parametrize("seats", [2, 60])
def test_philosophers_have_two_p_semiflows_each(seats):
    compiled = compile_net(catching_philosophers(seats))
    found = p_semiflows(compiled)
    assert found.complete
    assert len(found.flows) == 2 * seats
    assert found.covers(compiled.places)
