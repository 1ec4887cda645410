"""An order of places for decision diagrams, in which the places of a transition are close to each other.

FORCE (Aloul, Markov and Sakallah, GLSVLSI 2003): each place moves to the mean position of the transitions that touch
it, until the sum of the transitions' spans does not shrink any more.
"""

from im_pnt.model.compiled import Compiled

_ROUNDS = 60


def place_order(compiled: Compiled) -> tuple[int, ...]:
    """Return the places in an order with short spans."""
    arcs = zip(compiled.inputs, compiled.outputs, compiled.inhibitors, strict=True)
    edges = [sorted({place for part in parts for place, _ in part}) for parts in arcs]
    edges = [edge for edge in edges if len(edge) > 1]
    touching: list[list[int]] = [[] for _ in compiled.places]
    for number, edge in enumerate(edges):
        for place in edge:
            touching[place].append(number)
    starts = (_breadth_first(edges, touching), list(range(len(compiled.places))))
    best = min((_forced(start, edges, touching) for start in starts), key=lambda order: _span(order, edges))
    return tuple(best)


def _breadth_first(edges: list[list[int]], touching: list[list[int]]) -> list[int]:
    order: dict[int, None] = {}
    for first in range(len(touching)):
        if first in order:
            continue
        order[first] = None
        queue = [first]
        for place in queue:
            for number in touching[place]:
                for other in edges[number]:
                    if other not in order:
                        order[other] = None
                        queue.append(other)
    return list(order)


def _forced(order: list[int], edges: list[list[int]], touching: list[list[int]]) -> list[int]:
    best, span = order, _span(order, edges)
    for _ in range(_ROUNDS):
        at = {place: position for position, place in enumerate(order)}
        centres = [sum(at[place] for place in edge) / len(edge) for edge in edges]
        pull = [
            sum(centres[number] for number in numbers) / len(numbers) if numbers else float(at[place])
            for place, numbers in enumerate(touching)
        ]
        following = sorted(order, key=lambda place: (pull[place], at[place]))
        if following == order:
            break
        order = following
        if (shorter := _span(order, edges)) < span:
            best, span = order, shorter
    return best


def _span(order: list[int], edges: list[list[int]]) -> int:
    at = {place: position for position, place in enumerate(order)}
    return sum(max(at[place] for place in edge) - min(at[place] for place in edge) for edge in edges)
