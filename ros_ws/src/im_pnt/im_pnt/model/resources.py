"""Places of resources: tools, slots and semaphores, taken and given back by commands.

A place of a resource is declared (``resource: true``) or derived. Derived is one that is marked initially, whose tokens
a P-invariant brings back (a weighting of places that no firing changes, with no other place in it that is marked
initially), and from which a transition takes only where it learns elsewhere whom it works for: from a symbol, or from a
token of another place. So is a place of credits: a ``remote`` one that is marked initially and only taken from so; its
tokens come back from other nets. ``resource: false`` says that a place is none.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from math import gcd

from im_pnt.model.net import Net, Transition

_MAX_ROWS = 400
"""Rows of the working table at which a place counts as not derived; then it can be declared."""

_Row = tuple[dict[int, int], dict[str, int]]
"""What a weighting of places still changes, by outcome, and the weights."""


def resource_places(net: Net) -> frozenset[str]:
    """Return the places of resources."""
    declared = frozenset(place.name for place in net.places.values() if place.resource)
    if not net.symbols() and not net.services:
        return declared  # nothing in it belongs to anybody
    candidates = {place.name for place in net.places.values() if place.tokens and place.resource is None}
    while candidates:
        mute = [
            transition.inputs
            for transition in net.transitions.values()
            if transition.symbol is None and transition.inputs and declared | candidates >= transition.inputs.keys()
        ]
        bereft = candidates & set().union(*mute)
        if not bereft:
            break
        candidates -= bereft
    if not candidates:
        return declared
    outcomes = [change for each in _outcomes(net) if (change := {p: n for p, n in each.items() if n})]
    marked = frozenset(place.name for place in net.places.values() if place.tokens)
    remote = {name for name in candidates if net.places[name].remote}
    return declared | remote | {n for n in candidates - remote if _invariant(n, outcomes, marked - {n})}


def given_back(net: Net, taken: Mapping[str, int]) -> dict[str, int]:
    """Return the tokens that P-invariants bring back to the places marked initially, when others are taken out.

    Args:
        net: An expanded net.
        taken: Tokens that leave the net, by place.
    """
    marked = {place.name for place in net.places.values() if place.tokens}
    changes: list[Mapping[str, int]] = [{place.name: 1} for place in net.places.values() if place.remote]
    for each in net.transitions.values():
        names = each.inputs.keys() | each.outputs.keys()
        change = {name: each.outputs.get(name, 0) - each.inputs.get(name, 0) for name in names}
        changes += [{name: n for name, n in change.items() if n}, *({name: -1} for name in each.resets)]
    found: dict[str, int] = {}
    for name in net.places:
        if name in marked:
            weights = _invariant(name, changes, frozenset(marked - {name}))
            if count := sum(weights.get(place, 0) * tokens for place, tokens in taken.items()):
                found[name] = count // weights[name]
    return found


def _outcomes(net: Net) -> Iterator[Mapping[str, int]]:
    """Yield the change of the tokens of places by each way to fire, and by each outside event."""
    for transition in net.transitions.values():
        for outputs in _ends(net, transition):
            change = Counter(outputs)
            change.subtract(transition.inputs)
            yield change
        yield from ({name: -1} for name in transition.resets)
    for place in net.places.values():
        if place.on_invalid:
            change = Counter(place.on_invalid)
            change[place.name] -= 1
            yield change
        if place.remote:
            yield {place.name: 1}
    for service in net.services.values():
        yield from ({service.entry: 1}, {service.done: 1}, {service.failed: 1})


def _ends(net: Net, transition: Transition) -> Iterator[Mapping[str, int]]:
    yield transition.outputs
    if transition.action is not None:
        yield transition.on_failure or ({} if net.escalate is None else {net.escalate: 1})
        if transition.on_doubt:
            yield transition.on_doubt


def _invariant(name: str, outcomes: Sequence[Mapping[str, int]], others: frozenset[str]) -> Mapping[str, int]:
    """Return the weights of a P-invariant with one place, and none of some others; empty: none was found.

    Farkas' algorithm on the connected part.
    """
    touching: dict[str, list[int]] = {}
    for number, change in enumerate(outcomes):
        for place in change.keys() - others:
            touching.setdefault(place, []).append(number)
    rows: list[_Row] = []
    todo, seen = [name], {name}
    while todo:
        place = todo.pop()
        numbers = touching.get(place, [])
        rows.append(({number: outcomes[number][place] for number in numbers}, {place: 1}))
        near = {other for number in numbers for other in outcomes[number]} - others - seen
        seen |= near
        todo.extend(sorted(near))
    while True:
        left = Counter(number for rest, _ in rows for number in rest)
        if not left:
            return next((weights for _, weights in rows if name in weights), {})
        # the fewest products first: the table stays small
        column = min(left, key=lambda number: (left[number], number))
        kept = [row for row in rows if column not in row[0]]
        gains = [row for row in rows if row[0].get(column, 0) > 0]
        losses = [row for row in rows if row[0].get(column, 0) < 0]
        if len(kept) + len(gains) * len(losses) > _MAX_ROWS:
            return {}
        rows = _minimal([*kept, *(_joined(gain, loss, column) for gain in gains for loss in losses)])


def _joined(gain: _Row, loss: _Row, column: int) -> _Row:
    a, b = -loss[0][column], gain[0][column]
    rest = {n: a * gain[0].get(n, 0) + b * loss[0].get(n, 0) for n in gain[0].keys() | loss[0].keys()}
    weights = {
        place: a * gain[1].get(place, 0) + b * loss[1].get(place, 0) for place in gain[1].keys() | loss[1].keys()
    }
    divisor = gcd(*rest.values(), *weights.values())
    return (
        {n: value // divisor for n, value in rest.items() if value},
        {place: weight // divisor for place, weight in weights.items()},
    )


def _minimal(rows: list[_Row]) -> list[_Row]:
    """Drop weightings with a superset of another's places."""
    found: list[_Row] = []
    for row in sorted(rows, key=lambda row: len(row[1])):
        if not any(weights.keys() <= row[1].keys() for _, weights in found):
            found.append(row)
    return found
