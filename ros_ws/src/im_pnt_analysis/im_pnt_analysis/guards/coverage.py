"""Proof that guards leave no token waiting for ever: for each value at each place, one guard holds."""

import threading
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any

from im_pnt.errors import NetError
from im_pnt.expression.scope import NetScope
from im_pnt.expression.types import NoTypes
from im_pnt.model.net import Net, Role, Transition
from im_pnt_analysis.guards.formula import Formulas
from im_pnt_analysis.guards.knowledge import Knowledge, TokenKnowledge, Ways

MOST_CHANGING = 6
"""Values that may change at any time, of one place; with more nothing is decided."""
_EFFORT = 2_000_000
"""Resource units of z3 for each question: the same on every computer."""

_NETS = 64
"""Nets whose decisions are kept: each is composed alone, in its part, and with all others."""

_one_at_a_time = threading.Lock()  # z3 has one context


def decide_guards(net: Net) -> frozenset[str]:
    """Decide the guards of a net.

    Args:
        net: The net; one that is expanded was decided as written.

    Returns:
        Transitions whose guards are proved to leave no value out, with the others at their places.

    Raises:
        NetError: For some value no guard of a place holds; names the value, the place, and the lines.
    """
    return _decided(_SameNet(net))


class _SameNet:
    """Key of one net object: nets, which hold dictionaries, have no hash."""

    def __init__(self, net: Net) -> None:
        self.net = net

    def __hash__(self) -> int:
        return id(self.net)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameNet) and other.net is self.net


@lru_cache(maxsize=_NETS)
def _decided(key: _SameNet) -> frozenset[str]:
    net = key.net
    written = all(transition.role is Role.PLAIN for transition in net.transitions.values())
    if not written or not net.guards():
        return frozenset()
    coverage = GuardCoverage(net)
    coverage.check()
    return frozenset(coverage.decided)


class GuardCoverage:
    """Places of a net where a token waits for guarded transitions alone.

    Arguments, answers, failures, and data objects that the net itself stores stay as they are while a token waits: a
    net whose guards leave a value of these out is refused. Other data objects and enabling functions in Python may
    change, so a guard over them is a wait, and an assumption of the proof.

    Attributes:
        decided: Transitions whose guards are proved to leave no value out, with the others at their places.
    """

    def __init__(self, net: Net) -> None:
        self._net = net
        self._knowledge = Knowledge(net)
        self._scope = NetScope(net, NoTypes())
        self._stored = frozenset(name for t in net.transitions.values() for name in t.store)
        self.decided: set[str] = set()

    def check(self) -> None:
        """Decide all places.

        Raises:
            NetError: For some value no guard of a place holds; names the value, the place, and the lines.
        """
        decided: dict[str, bool] = {}
        for kind in (*self._net.begun_symbols(), *self._net.services):
            ways = self._knowledge.ways(kind)
            for place in sorted(ways):
                guarded = self._guarded(place, kind)
                if guarded:
                    proved = all(self._covers(place, kind, guarded, known) for known in self._at(guarded, ways))
                    for transition in guarded:
                        decided[transition.name] = decided.get(transition.name, True) and proved
        self.decided = {name for name, proved in decided.items() if proved}

    def _guarded(self, place: str, kind: str) -> list[Transition]:
        """Return the takers of a place if all have guards, and need the same tokens, and nothing else moves one."""
        net = self._net
        takers = [t for t in net.transitions.values() if place in t.inputs and self._knowledge.serves(t, kind)]
        ends = any(place in (service.done, service.failed) for service in net.services.values())
        if ends or net.places[place].on_invalid or len({self._knowledge.work_inputs(each) for each in takers}) != 1:
            return []
        if any(each.guard is None or each.symbol is not None for each in takers):
            return []
        return takers

    def _at(self, guarded: list[Transition], ways: Ways) -> frozenset[TokenKnowledge]:
        return self._knowledge.together(self._knowledge.work_inputs(guarded[0]), ways)

    def _covers(self, place: str, kind: str, guarded: list[Transition], known: TokenKnowledge) -> bool:
        with _one_at_a_time:
            values = self._left_out(guarded, kind, known, whole=False)
        if values:
            lines = [str(each.line) for each in guarded if each.line]
            where = f" ({self._net.source}:{', :'.join(lines)})" if lines else ""
            text = (
                f"net {self._net.name}: with {values} nothing fires at '{place}'{where}; "
                "cover this case, or give a transition the guard 'otherwise'"
            )
            raise NetError(text, net=self._net.name, place=place, values=values)
        return values == ""

    def _left_out(self, guarded: list[Transition], kind: str, known: TokenKnowledge, *, whole: bool) -> str | None:
        """Return values that no guard lets pass for good, in words; empty: there are none; None: undecided."""
        import z3  # takes longer than most nets do

        schema, meanings = self._net.arguments_of(kind), self._scope.meanings(guarded[0])
        symbol = "" if kind in self._net.services else kind
        formulas = Formulas(z3, schema, symbol, known.answered, self._stored, meanings, whole)
        held = z3.Or([formulas.holds(each.guard) for each in guarded if each.guard is not None])
        facts = [formulas.holds(guard) for guard in sorted(known.facts, key=str)]
        solver = z3.Solver()
        solver.set("rlimit", _EFFORT)
        solver.add(*formulas.limits(), *facts)
        values = _found(z3, solver, formulas, [z3.Not(held)])
        if values and formulas.changing:
            if len(formulas.changing) > MOST_CHANGING:
                return None
            lasting = [z3.Not(z3.substitute(held, *chance)) for chance in _chances(z3, formulas)]
            values = _found(z3, solver, formulas, lasting) or None
        if values and formulas.uncertain and not whole:
            return self._left_out(guarded, kind, known, whole=True) or None
        return values


def _found(z3: Any, solver: Any, formulas: Formulas, wanted: list[Any]) -> str | None:
    """Return values for which conditions hold, in words; empty: there are none; None: not found out."""
    solver.push()
    solver.add(*wanted)
    answer = solver.check()
    told = formulas.told(solver.model()) or "any values" if answer == z3.sat else ""
    solver.pop()
    return None if answer == z3.unknown else told


def _chances(z3: Any, formulas: Formulas) -> Iterator[list[tuple[Any, Any]]]:
    """Yield all combinations of conditions that may change."""
    changing = list(formulas.changing.values())
    for values in product((False, True), repeat=len(changing)):
        yield [(each, z3.BoolVal(value)) for each, value in zip(changing, values, strict=True)]
