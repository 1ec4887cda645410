"""Proof that guards leave no command waiting for ever: for each value at each marking, one guard holds."""

import threading
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations, product
from typing import Any

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.expression.inference import Meanings
from im_pnt.expression.scope import NetScope
from im_pnt.expression.template import nodes, references
from im_pnt.expression.types import ANY, NoTypes, ValueType, installed_types
from im_pnt.model.net import Guard, Net, ObjectScope, Place, Role, Transition
from im_pnt.model.resources import resource_places
from im_pnt_analysis.guards.command_markings import CommandMarkings, may_never_fire
from im_pnt_analysis.guards.formula import Formulas, ValueKnowledge
from im_pnt_analysis.guards.knowledge import NO_FAILURE, Knowledge, TokenKnowledge, Ways
from im_pnt_analysis.guards.stored_values import named, stored_bounds

MOST_CHANGING = 6
"""Values that may change at any time, of one place; with more nothing is decided."""
_EFFORT = 2_000_000
"""Resource units of z3 for each question: the same on every computer."""

_NETS = 64
"""Nets whose decisions are kept: each is composed alone, in its part, and with all others."""

_one_at_a_time = threading.Lock()  # z3 has one context


@dataclass(frozen=True, slots=True)
class GuardDecisions:
    """Decisions about the guards of a net.

    Attributes:
        decided: Transitions whose guards are proved to leave no value out, with the others at their places.
        choices: Transitions of which exactly one guard holds for each value, but that do not need the same beside the
            tokens of the command.
        never: Transitions whose guards hold for no value that their tokens can have.
        granted: Values that are taken to be there: arguments of a command that declares none, and fields of objects.
    """

    decided: frozenset[str] = frozenset()
    choices: tuple[tuple[str, ...], ...] = ()
    never: frozenset[str] = frozenset()
    granted: frozenset[str] = frozenset()


def decide_guards(net: Net) -> GuardDecisions:
    """Decide the guards of a net, once for each net object.

    Args:
        net: The net; one that is expanded was decided as written.

    Raises:
        NetError: For some value no guard of a place holds; names the value, the place, and the lines.
    """
    return _decided(_SameNet(net))


def recall_decisions(net: Net, known: GuardDecisions) -> None:
    """Have :func:`decide_guards` return the decisions of an earlier proof of a net."""
    _decided(_SameNet(net, known))


def settled_choices(net: Net) -> Net:
    """Return a net with a place for each choice of guards, where the token waits for the needs of that choice alone.

    That differs where transitions at one place need different resources, or are inhibited by different places: the
    token waits for the resource of the transition whose guard holds, though that of another one is free. A transition
    whose guard never holds where its tokens come from needs a token that is never there.

    Args:
        net: As of :func:`decide_guards`.
    """
    decisions, resources = decide_guards(net), resource_places(net)
    places, transitions = dict(net.places), dict(net.transitions)
    waiting: dict[str, dict[str, int]] = {}
    for name in decisions.never:
        places[f"{name}.never"] = Place(f"{name}.never")
        inputs = {**net.transitions[name].inputs, f"{name}.never": 1}
        transitions[name] = replace(net.transitions[name], inputs=inputs)
    for name in (name for names in decisions.choices for name in names):
        taker, way = transitions[name], f"{name}.chosen"
        needs = {place: weight for place, weight in taker.inputs.items() if place in resources}
        work = {place: weight for place, weight in taker.inputs.items() if place not in needs}
        for place in work:
            waiting.setdefault(place, {})[way] = 1
        places[way] = Place(way)
        transitions[f"{name}.choose"] = Transition(
            f"{name}.choose", work, {way: 1}, origin=name, guard=taker.guard, keeps_failure=True, line=taker.line
        )
        transitions[name] = replace(taker, inputs={way: 1, **needs}, guard=None)
    for name, each in transitions.items():
        seen = {way: 1 for place in each.inhibitors for way in waiting.get(place, ())}
        if seen:  # one that waits is still there for them
            transitions[name] = replace(each, inhibitors={**each.inhibitors, **seen})
    return replace(net, places=places, transitions=transitions) if transitions != net.transitions else net


def types_read(net: Net) -> list[str]:
    """Return the types of the values that guards read of messages, as text; a proof holds for these alone.

    Args:
        net: The net as written.
    """
    paths = {path for guard in net.guards() for node in nodes(guard) for path in references(node)}
    paths = {path for path in paths if path[0] in ("answers", "data")}
    if not paths:
        return []
    types = installed_types()
    scope = NetScope(net, types).meanings(next(iter(net.transitions.values())))
    return [f"{'.'.join(path)}: {_type_at(path, scope)}" for path in sorted(paths)]


def _type_at(path: tuple[str, ...], scope: Meanings) -> ValueType:
    """Return the type at the end of a way into a message, through lists too."""
    try:
        found = (scope.answers if path[0] == "answers" else scope.data)(path[1])
        for name in path[2:]:
            while found.element is not None:
                found = found.element
            found = (scope.types.fields(found.message) or {}).get(name, ANY)
    except ImError:
        return ANY
    return found


class _SameNet:
    """Key of one net object, perhaps with known decisions: nets, which hold dictionaries, have no hash."""

    def __init__(self, net: Net, known: GuardDecisions | None = None) -> None:
        self.net, self.known = net, known

    def __hash__(self) -> int:
        return id(self.net)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _SameNet) and other.net is self.net


@lru_cache(maxsize=_NETS)
def _decided(key: _SameNet) -> GuardDecisions:
    net = key.net
    if key.known is not None:
        return key.known
    if not net.guards() or any(transition.role is not Role.PLAIN for transition in net.transitions.values()):
        return GuardDecisions()
    coverage = GuardCoverage(net)
    coverage.check()
    never, granted = frozenset(coverage.never), frozenset(coverage.granted)
    return GuardDecisions(frozenset(coverage.decided), tuple(coverage.choices), never, granted)


class GuardCoverage:
    """Markings of a command where its tokens wait for guarded transitions alone.

    Arguments, answers, failures, and data objects that the net itself stores stay as they are while a token waits: a
    net whose guards leave a value of these out is refused. Other data objects and enabling functions in Python may
    change, so a guard over them is a wait, and an assumption of the proof.

    Attributes:
        resources: Places whose tokens belong to nobody.
        decided, choices, never, granted: As of :class:`GuardDecisions`, once :meth:`check` has decided.
    """

    def __init__(self, net: Net) -> None:
        self._net = net
        read = (path[0] for guard in net.guards() for node in nodes(guard) for path in references(node))
        typed = not {"answers", "data"}.isdisjoint(read)
        self._scope = NetScope(net, installed_types() if typed else NoTypes())
        common = {place.data_object for place in net.places.values() if place.object_scope is ObjectScope.GLOBAL}
        stored = {name for t in net.transitions.values() for name in t.store}
        self._stored = frozenset(stored - common)
        self._knowledge = Knowledge(net, self._scope, self._stored)
        self._bounds = {path: found for name in self._stored for path, found in stored_bounds(net, name).items()}
        self.resources = self._knowledge.resources
        self._asked: dict[object, bool] = {}
        self.choices: list[tuple[str, ...]] = []
        self.never: set[str] = set()
        self.decided: set[str] = set()
        self.granted: set[str] = set()

    def check(self) -> None:
        """Decide all guards at all markings of each command and service.

        Raises:
            NetError: For some value no guard holds at a marking; names the value, a place, and the lines.
        """
        decided: dict[str, bool] = {}
        found: dict[str, Ways] = {}
        apart: dict[tuple[str, ...], bool] = {}
        for kind in (*self._net.begun_symbols(), *self._net.services):
            if not any(t.guard and self._knowledge.serves(t, kind) for t in self._net.transitions.values()):
                continue
            ways = found[kind] = self._knowledge.ways(kind)
            markings = CommandMarkings(self._net, self._knowledge, kind)
            looked: dict[tuple[str, ...], bool] = {}
            for places, enabled in markings:
                for each in enabled:
                    if each.guard is not None:
                        decided.setdefault(each.name, True)
                guarded, undecided = self._guarded(places, enabled)
                decided |= dict.fromkeys(undecided, False)
                names = tuple(each.name for each in guarded)
                if guarded and names not in looked:
                    looked[names] = self._is_covered(kind, guarded, ways, apart)
                decided |= {name: decided[name] and looked[names] for name in names}
            if not markings.complete:
                decided |= {t.name: False for t in self._net.transitions.values() if self._knowledge.serves(t, kind)}
        self.decided = {name for name, proved in decided.items() if proved}
        self.choices = [names for names, several in apart.items() if several and self.decided.issuperset(names)]
        for each in (self._net.transitions[name] for names in self.choices for name in names):
            serving = [(kind, ways) for kind, ways in found.items() if self._knowledge.serves(each, kind)]
            if all(self._is_never(kind, each, ways) for kind, ways in serving):
                self.never.add(each.name)

    def _guarded(self, places: frozenset[str], enabled: list[Transition]) -> tuple[list[Transition], list[str]]:
        """Return the guarded transitions that alone move a marking, and the names of those that nothing decides.

        Nothing decides a guard beside a transition that may never fire, or over a token that may leave with its object.
        """
        if any({service.done, service.failed} & places for service in self._net.services.values()):
            return [], []
        loose = [each for each in enabled if may_never_fire(each)]
        if any(each.guard is None and each not in loose for each in enabled):
            return [], []
        leaving = {place for place in places if place in self._net.places and self._net.places[place].on_invalid}
        leaving = leaving.union(*(self._knowledge.work_inputs(each) for each in loose))
        guarded = [each for each in enabled if each.guard is not None and each not in loose]
        alone = [each for each in guarded if not self._knowledge.work_inputs(each) & leaving]
        return alone, [each.name for each in guarded if each not in alone]

    def _is_covered(self, kind: str, guarded: list[Transition], ways: Ways, apart: dict[tuple[str, ...], bool]) -> bool:
        """Return whether for each value one of some guards holds; note which choices have just one.

        Raises:
            NetError: None holds for some value.
        """
        covered = False not in [self._covers(kind, guarded, known) for known in self._at(guarded, ways)]
        for several in filter(self._differ, self._contending(guarded)):
            exact = len({self._needs(each) for each in several}) == 1 and not self._looked_at(several[0])
            exact = exact and all(self._are_apart(kind, several, known) for known in self._at(several, ways))
            names = tuple(each.name for each in several)
            apart[names] = exact = exact and apart.get(names, True)
            covered = covered and exact
        return covered

    def _contending(self, guarded: list[Transition]) -> Iterator[list[Transition]]:
        """Yield the groups of transitions that contend for tokens."""
        left = guarded
        while left:
            group, places = [left[0]], set(self._knowledge.work_inputs(left[0]))
            while more := [t for t in left if t not in group and places & self._knowledge.work_inputs(t)]:
                group += more
                places.update(*(self._knowledge.work_inputs(each) for each in more))
            yield [each for each in left if each in group]
            left = [each for each in left if each not in group]

    def _needs(self, transition: Transition) -> frozenset[tuple[str, int]]:
        """Return the tokens of the command that a transition takes."""
        return frozenset((place, transition.inputs[place]) for place in self._knowledge.work_inputs(transition))

    def _at(self, guarded: list[Transition], ways: Ways) -> frozenset[TokenKnowledge]:
        places = frozenset[str]().union(*(self._knowledge.work_inputs(each) for each in guarded))
        guards = [each.guard for each in guarded if each.guard is not None]
        return frozenset(known.about(guards) for known in self._knowledge.together(places, ways))

    def _differ(self, guarded: list[Transition]) -> bool:
        """Return whether transitions need different things beside the tokens of the command."""
        rest = {place: each.inputs[place] for each in guarded for place in each.inputs if place in self.resources}
        return any(
            {place: each.inputs.get(place, 0) for place in rest} != rest or each.inhibitors != guarded[0].inhibitors
            for each in guarded
        )

    def _looked_at(self, transition: Transition) -> bool:
        """Return whether an inhibitor counts several tokens that wait for a transition."""
        places = self._knowledge.work_inputs(transition)
        others = self._net.transitions.values()
        return any(weight > 1 and place in places for each in others for place, weight in each.inhibitors.items())

    def _is_never(self, kind: str, transition: Transition, ways: Ways) -> bool:
        """Return whether the guard of a transition is false for all values of a command's tokens at its places."""
        import z3

        work = self._knowledge.work_inputs(transition)
        if not work or not work <= ways.keys() or transition.guard is None:
            return False
        at = self._at([transition], ways)
        possible = False
        for known in at:
            given = replace(self._given(kind, [transition], known), rounded=True)
            with _one_at_a_time:
                formulas, solver, held = _question(z3, [transition], known, given)
                if solver.check() == z3.unsat:
                    continue  # no token comes this way
                possible = True
                solver.add(*held)
                if formulas.granted or solver.check() != z3.unsat:
                    return False
        return possible

    def _covers(self, kind: str, guarded: list[Transition], known: TokenKnowledge) -> bool:
        """Return whether one of some guards holds for each value; asked once for the same guards and knowledge."""
        guards = tuple(each.guard for each in guarded if each.guard is not None)
        facts = tuple(_relevant(known.facts | known.stored, guarded))
        answered = known.answered & {name for each in (*guards, *facts) for way in named(each) for name in way[1:2]}
        question = kind, self._scope.works_for(guarded[0]), guards, facts, answered
        if question not in self._asked:
            self._asked[question] = self._answer(kind, guarded, known)
        return self._asked[question]

    def _answer(self, kind: str, guarded: list[Transition], known: TokenKnowledge) -> bool:
        with _one_at_a_time:
            values = self._left_out(guarded, known, self._given(kind, guarded, known))
        if values:
            takers = Counter(place for each in guarded for place in sorted(self._knowledge.work_inputs(each)))
            place = max(sorted(takers), key=takers.__getitem__)
            lines = [str(each.line) for each in guarded if each.line]
            where = f" ({self._net.source}:{', :'.join(lines)})" if lines else ""
            text = (
                f"net {self._net.name}: with {values} nothing fires at '{place}'{where}; "
                "cover this case, or give a transition the guard 'otherwise'"
            )
            raise NetError(text, net=self._net.name, place=place, values=values)
        return values == ""

    def _given(self, kind: str, guarded: list[Transition], known: TokenKnowledge) -> ValueKnowledge:
        schema, symbol = self._net.arguments_of(kind), "" if kind in self._net.services else kind
        meanings = self._scope.meanings(guarded[0])
        return ValueKnowledge(schema, symbol, known.answered, self._stored, self._bounds, meanings)

    def _are_apart(self, kind: str, guarded: list[Transition], known: TokenKnowledge) -> bool:
        """Return whether no two guards hold for one value, now or later."""
        import z3

        with _one_at_a_time:
            formulas, solver, held = _question(z3, guarded, known, self._given(kind, guarded, known))
            solver.add(z3.Or([z3.And(one, other) for one, other in combinations(held, 2)]))
            return not formulas.changing and bool(solver.check() == z3.unsat)

    def _left_out(self, guarded: list[Transition], known: TokenKnowledge, given: ValueKnowledge) -> str | None:
        """Return values that no guard lets pass for good, in words; empty: there are none; None: undecided."""
        import z3  # takes longer than most nets do

        formulas, solver, passing = _question(z3, guarded, known, given)
        held = z3.Or(passing)
        self.granted |= formulas.granted
        values = _found(z3, solver, formulas, [z3.Not(held)])
        if values and formulas.changing:
            if len(formulas.changing) > MOST_CHANGING:
                return None
            lasting = [z3.Not(z3.substitute(held, *chance)) for chance in _chances(z3, formulas)]
            values = _found(z3, solver, formulas, lasting) or None
        if given.rounded:
            return values and None  # such values are none that a floating-point number need have
        if values and formulas.uncertain and not given.whole:
            return self._left_out(guarded, known, replace(given, whole=True)) or None
        if values == "" and formulas.inexact:
            return self._left_out(guarded, known, replace(given, rounded=True))
        return values


def _question(
    z3: Any, guarded: list[Transition], known: TokenKnowledge, given: ValueKnowledge
) -> tuple[Formulas, Any, list[Any]]:
    """Return the formulas at a place, a solver of the facts there, and the condition of each guard."""
    formulas = Formulas(z3, given)
    held = [formulas.holds(each.guard) for each in guarded if each.guard is not None]
    facts = [formulas.holds(guard) for guard in _relevant(known.facts | known.stored, guarded)]
    solver = z3.Solver()
    solver.set("rlimit", _EFFORT)
    solver.add(*formulas.limits(), *facts)
    return formulas, solver, held


def _relevant(facts: frozenset[Guard], guarded: list[Transition]) -> list[Guard]:
    """Return facts in order; without failures, which all guards may know of, where no guard asks for one."""
    others = [guard for guard in facts if guard != NO_FAILURE]
    asking = [*others, *(each.guard for each in guarded if each.guard is not None)]
    asked = any(path[0] == "failure" for guard in asking for path in named(guard))
    return sorted(facts if asked else others, key=str)


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
