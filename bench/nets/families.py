"""Families of nets with known answers, as large as one likes."""

from collections.abc import Callable, Mapping

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.model.action import FunctionAction
from im_pnt.model.net import Net, Place, Transition

LARGEST = 100_000
"""Largest size of a net: it is held in memory."""

ACTION = "count"
"""Name of the function that the transitions of a net with actions call."""


def ring(places: int, action: bool = False) -> Net:
    """Make a ring: one token goes round."""
    _check_size("places of a ring", places, 2)
    arcs = {f"t{i}": ((f"p{i}",), (f"p{(i + 1) % places}",)) for i in range(places)}
    return _net(f"ring_{places}", {f"p{i}": int(i == 0) for i in range(places)}, arcs, action)


def philosophers(places: int, action: bool = False) -> Net:
    """Make dining philosophers with both forks at once: think, eat and fork, take and put.

    Args:
        places: Number of places, rounded up to three for each philosopher.
        action: Whether each transition calls :data:`ACTION`.
    """
    _check_size("places of dining philosophers", places, 6)
    seats = range(-(-places // 3))
    tokens = {f"think{i}": 1 for i in seats} | {f"eat{i}": 0 for i in seats} | {f"fork{i}": 1 for i in seats}
    arcs: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
    for i in seats:
        free = (f"think{i}", f"fork{i}", f"fork{(i + 1) % len(seats)}")
        arcs[f"take{i}"] = free, (f"eat{i}",)
        arcs[f"put{i}"] = (f"eat{i}",), free
    return _net(f"philosophers_{places}", tokens, arcs, action)


def catching_philosophers(seats: int) -> Net:
    """Make philosophers taking one fork after the other, in either order: 3^n markings, including two deadlocks.

    The model "Philosophers" of the Model Checking Contest.
    """
    _check_size("philosophers", seats, 2)
    tokens: dict[str, int] = {}
    arcs: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
    for i in range(seats):
        tokens |= {f"think{i}": 1, f"fork{i}": 1, f"eat{i}": 0, f"left{i}": 0, f"right{i}": 0}
        left, right = f"fork{i}", f"fork{(i + 1) % seats}"
        arcs[f"take_left{i}"] = (f"think{i}", left), (f"left{i}",)
        arcs[f"take_right{i}"] = (f"think{i}", right), (f"right{i}",)
        arcs[f"then_right{i}"] = (f"left{i}", right), (f"eat{i}",)
        arcs[f"then_left{i}"] = (f"right{i}", left), (f"eat{i}",)
        arcs[f"end{i}"] = (f"eat{i}",), (f"think{i}", left, right)
    return _net(f"catching_philosophers_{seats}", tokens, arcs)


def kanban(cards: int) -> Net:
    """Make four cells for making, inspecting and repairing parts, with as many cards each.

    Ciardo and Tilgner, "On the use of Kronecker operators for the solution of generalized stochastic Petri nets"
    (ICASE report 96-35, 1996).
    """
    _check_size("cards of a Kanban system", cards, 1)
    tokens: dict[str, int] = {}
    arcs: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {}
    for i in range(1, 5):
        tokens |= {f"free{i}": cards, f"making{i}": 0, f"bad{i}": 0, f"done{i}": 0}
        arcs[f"good{i}"] = (f"making{i}",), (f"done{i}",)
        arcs[f"spoilt{i}"] = (f"making{i}",), (f"bad{i}",)
        arcs[f"again{i}"] = (f"bad{i}",), (f"making{i}",)
    arcs["enter"] = ("free1",), ("making1",)
    arcs["split"] = ("done1", "free2", "free3"), ("free1", "making2", "making3")
    arcs["join"] = ("done2", "done3", "free4"), ("free2", "free3", "making4")
    arcs["leave"] = ("done4",), ("free4",)
    return _net(f"kanban_{cards}", tokens, arcs)


FAMILIES: Mapping[str, Callable[[int], Net]] = {
    "ring": ring,
    "philosophers": philosophers,
    "catching_philosophers": catching_philosophers,
    "kanban": kanban,
}


def by_name(name: str) -> Net:
    """Return a net of a family, e.g. ``kanban:5``.

    Raises:
        NetError: There is no such family, or the size is no number, too small or too large.
    """
    family, _, size = name.partition(":")
    if family not in FAMILIES:
        raise NetError(f"there is no family of nets '{family}'{nearest(family, FAMILIES)}", family=family)
    if not size.isdecimal():
        raise NetError(f"family {family} needs a size, e.g. {family}:10, not '{name}'", family=family)
    return FAMILIES[family](int(size))


def _check_size(what: str, value: int, least: int) -> None:
    if not least <= value <= LARGEST:
        raise NetError(f"{value} {what}: {least} to {LARGEST} are possible", value=value)


def _net(
    name: str,
    tokens: Mapping[str, int],
    arcs: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]],
    action: bool = False,
) -> Net:
    """Make a net; every marking counts as rest, so only a marking without a possible firing is stuck."""
    function = FunctionAction(ACTION) if action else None
    transitions = {
        transition: Transition(
            transition,
            inputs=dict.fromkeys(taken, 1),
            outputs=dict.fromkeys(given, 1),
            action=function,
            on_failure=dict.fromkeys(taken, 1) if action else {},
            origin=transition,
        )
        for transition, (taken, given) in arcs.items()
    }
    return Net(name, {place: Place(place, count) for place, count in tokens.items()}, transitions)
