"""Proof of held resources: for each command and request, over all ways of the tokens.

A token belongs to one command or request, or to nobody (docs/nets.md), and a firing takes tokens of one of them and of
nobody. So it is enough to follow the tokens of one at a time, while places that may hold tokens of nobody (resources,
what ended commands have left) give as many as are wanted: more can happen then than in the nets, never less. A command
that has ended holds nothing; what still runs for it, and what begins with what it has left, acts on what is not held.
Whose tokens come from another net is taken to hold nothing.
"""

import itertools
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from im_core.clock import thread_cpu
from im_pnt.execution.jobs import ends
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import active_place, cancelling_place, doubt_place, expand
from im_pnt.model.net import Net, ReadFor, Role, Transition
from im_pnt.model.resource_use import speaks_of_resources, untold
from im_pnt.model.resources import resource_places
from im_pnt.verification import Counterexample
from im_pnt_analysis.composition.resource_use import NOBODY, VISIT, Acting, UntoldError, Work, works_of
from im_pnt_analysis.structure.semiflows import p_semiflows

MOST = 100_000
"""Markings of one work at which it is given up."""

_Tokens = tuple[tuple[str, int], ...]
"""Marked places with their tokens; the most that is counted stands for any more."""

_Way = tuple[str, ...]


class UndecidedError(Exception):
    """Error: the proof takes too long."""


def unheld(nets: Sequence[Net], deadline: float) -> list[Counterexample] | None:
    """Find uses of resources without a hold.

    Args:
        nets: Nets as written, those that talk to each other.
        deadline: Time of :func:`im_core.clock.thread_cpu` at which to give up [s].

    Returns:
        For each transition that does so the first case, and one for each that does not say what it acts on where these
        nets speak of resources; None where nothing in the files acts on anything.

    Raises:
        UndecidedError: It takes too long.
    """
    acting = Acting(nets)
    owners: dict[str, list[str]] = {}
    for net in nets:
        for place in resource_places(net):
            owners.setdefault(place, []).append(net.name)
    found: list[Counterexample] | None = None
    if any(map(speaks_of_resources, nets)):
        found = [Counterexample("unheld", sentence, (), {}) for net in nets for sentence in untold(net)] or None
    for net in nets:
        own = frozenset(place for place, having in owners.items() if having == [net.name])
        holding = _Holding(net, acting, own, f"{net.name}." if len(nets) > 1 else "", deadline)
        works = list(works_of(net))
        if holding.acts(works):
            found = [*(found or ()), *holding.cases(works)]
    return found


def _shortened(part: Transition) -> Transition | None:
    """Return a transition of an expanded net with an active user, also during cancellation or doubt."""
    active = {active_place(part.origin): 1}
    if part.role is Role.GIVEN_UP:
        return replace(part, inputs=active)
    if part.role in (Role.CANCEL, Role.LOST) or (part.role in (Role.END, Role.FAILED) and part.inputs != active):
        return None
    return part


class _Holding:
    """One net.

    Attributes:
        free: Places that may hold tokens of nobody, with a way to have one there.
        foreign: Commands and services that others may end, with a way to it.
        found: What is wrong, by transition.
    """

    def __init__(self, net: Net, acting: Acting, own: frozenset[str], prefix: str, deadline: float) -> None:
        self.net, self.acting, self.own, self.prefix, self.deadline = net, acting, own, prefix, deadline
        self.whole = expand(net)
        self.resources = resource_places(net) | {p.name for p in self.whole.places.values() if p.resource}
        self.parts = [part for t in self.whole.transitions.values() if (part := _shortened(t)) is not None]
        self.begins = {t.origin: t for t in self.parts if t.action is not None}
        self.takers: dict[str, list[Transition]] = {}
        for t in self.parts:
            for place in t.inputs.keys() - self.resources:
                self.takers.setdefault(place, []).append(t)
        weights = (weight for t in self.parts for arcs in (t.inputs, t.outputs) for weight in arcs.values())
        self.most = 1 + max(weights, default=1)
        marked = [p for p in net.places.values() if (p.tokens or p.remote) and p.name not in self.resources]
        self.free: dict[str, _Way] = {place.name: () for place in marked}
        self.foreign: dict[str, _Way] = {}
        self.found: dict[str, Counterexample] = {}
        self._kept: Mapping[str, frozenset[str]] | None = None

    def cases(self, works: Sequence[Work]) -> list[Counterexample]:
        """Return the faults."""
        before = None
        while before != (len(self.free), len(self.foreign)):
            before = len(self.free), len(self.foreign)
            self._fire_for_nobody()
            for work in (*works, VISIT):
                self._follow(work)
        return list(self.found.values())

    def acts(self, works: Sequence[Work]) -> bool:
        """Whether anything acts on something at all."""
        for transition, work in itertools.product(self.begins.values(), (NOBODY, *works)):
            try:
                if self.acting.acts_on(transition, work):
                    return True
            except UntoldError:
                return True
        return False

    # Nobody's tokens.

    def _fire_for_nobody(self) -> None:
        """Fire all transitions on tokens of no command only, and add the places marked by the firings."""
        changed = True
        while changed:
            changed = False
            for t in self.parts:
                for place in self._given_for_nobody(t):
                    if place not in self.free:
                        self.free[place] = self._way_for_nobody(t)
                        changed = True

    def _given_for_nobody(self, t: Transition) -> list[str]:
        reads = t.symbol is not None
        if t.role is Role.ACCEPT or (reads and t.symbol_of is not ReadFor.NOBODY) or not (reads or t.inputs):
            return []
        if not t.inputs.keys() <= self.free.keys() | self.resources:
            return []
        way = self._way_for_nobody(t)
        if t.action is not None:
            self._require(t, NOBODY, way, {}, "for nobody: the tokens that it takes are those of no command under way")
        self._end_others(t, None, way)
        return [place for place in t.outputs if place not in self.resources]

    def _way_for_nobody(self, t: Transition) -> _Way:
        parts = [self.free[place] for place in t.inputs if place in self.free]
        return (*itertools.chain.from_iterable(dict.fromkeys(parts)), t.name)

    def _end_others(self, t: Transition, work: Work | None, way: _Way) -> None:
        """Note the other commands ended by a firing."""
        own = None if work is None or work.is_request else work.kind
        for symbol in self.net.symbols():
            if symbol != own and any(ends(emitted, symbol) is not None for emitted in t.emit):
                self.foreign.setdefault(symbol, way)

    # The tokens of one command or request.

    def _follow(self, work: Work) -> None:
        seen: dict[_Tokens, _Way] = {}
        waiting: deque[_Tokens] = deque()

        def reach(tokens: Mapping[str, int], way: _Way) -> None:
            state = tuple(sorted((place, count) for place, count in tokens.items() if count))
            if state not in seen:
                seen[state] = way
                waiting.append(state)

        for tokens, way, ended in self._beginnings(work):
            if ended:
                self._end(work, tokens, way)
            else:
                reach(tokens, way)
        while waiting:
            if len(seen) > MOST or thread_cpu() > self.deadline:
                raise UndecidedError(f"net {self.net.name} has more than {len(seen)} markings to follow tokens in")
            state = waiting.popleft()
            here, way = dict(state), seen[state]
            if work.kind in self.foreign:
                self._end(work, here, (*way, *self.foreign[work.kind]))
            if work is VISIT:
                self._end(work, here, way)
            if work.is_request and self._answered_by_others(work.kind):
                self._end(work, here, (*way, f"t_f.{work.kind}"))
            # each once, in the same order in every run
            for t in {t.name: t for place in here for t in self.takers.get(place, ())}.values():
                if not work.may_pass(t.guard):
                    continue
                for left in self._taken(t, here):
                    on = (*way, t.name)
                    if t.action is not None:
                        self._require(t, work, on, here)
                    self._end_others(t, work, on)
                    after = self._given(t, left)
                    if self._is_end(t, work):
                        self._end(work, after, on)
                    else:
                        reach(after, on)

    def _beginnings(self, work: Work) -> Iterator[tuple[dict[str, int], _Way, bool]]:
        if work is VISIT:
            for place in self.net.places.values():
                if place.remote and place.name not in self.resources:
                    yield {place.name: self.most}, (), False
            return
        if work.is_request:
            accept = self.whole.transitions[f"accept.{work.kind}"]
            yield self._given(accept, {}), (accept.name,), False
            return
        for t in self.parts:
            if t.symbol != work.kind or t.symbol_of is not None or not work.may_pass(t.guard):
                continue
            if t.inputs.keys() <= self.free.keys() | self.resources:
                if t.action is not None:
                    self._require(t, work, (t.name,), {})
                self._end_others(t, work, (t.name,))
                yield self._given(t, {}), (t.name,), self._is_end(t, work)

    def _taken(self, t: Transition, here: Mapping[str, int]) -> Iterator[dict[str, int]]:
        """Yield the remaining tokens of a work after a firing, taking tokens of the work before free ones."""
        options: list[list[tuple[str, int]]] = []
        for place, weight in t.inputs.items():
            if place in self.resources:
                continue
            count = here.get(place, 0)
            if count < weight and place not in self.free:
                return
            rest = range(count - weight, count + 1) if count == self.most else (max(0, count - weight),)
            options.append([(place, number) for number in rest])
        for left in itertools.product(*options):
            yield {**here, **dict(left)}

    def _given(self, t: Transition, left: Mapping[str, int]) -> dict[str, int]:
        after = dict(left)
        for place, weight in t.outputs.items():
            if place not in self.resources:
                after[place] = min(self.most, after.get(place, 0) + weight)
        return after

    def _is_end(self, t: Transition, work: Work) -> bool:
        if work.is_request:
            return t.role in (Role.FINISH, Role.FINISH_FAILED) and t.origin == work.kind
        return any(ends(emitted, work.kind) is not None for emitted in t.emit)

    def _answered_by_others(self, service: str) -> bool:
        offered = self.net.services[service]
        return offered.done in self.free or offered.failed in self.free

    def _end(self, work: Work, tokens: Mapping[str, int], way: _Way) -> None:
        """End a work; the remaining tokens are free, and none of the actions may go on."""
        for t in self.begins.values():
            if tokens.get(active_place(t.origin)):
                self._require(t, work, way, tokens, f"when {work} has ended, which held it", held=frozenset())
        for place, count in tokens.items():
            if count and place not in self.free:
                self.free[place] = way

    # Verdicts.

    def _require(
        self,
        t: Transition,
        work: Work,
        way: _Way,
        tokens: Mapping[str, int],
        when: str = "",
        held: frozenset[str] | None = None,
    ) -> None:
        """Note a case, if a transition uses an unheld resource."""
        if t.origin in self.found:
            return
        has = work.held if held is None else held
        where = self.net.place_of(t)
        who = f"{where}transition {t.origin} of net {self.net.name}"
        try:
            lacking = self.acting.acts_on(t, work) - has
        except UntoldError as error:
            reason = f"{who} acts {when}" if when else f"{who}: what it acts on for {work} cannot be told: {error}"
        else:
            lacking = lacking and lacking - self._kept_by(t.origin)
            if not lacking:
                return
            holds = f"it holds {', '.join(sorted(has)) or 'nothing'}"
            reason = f"{who} acts on {', '.join(sorted(lacking))}"
            reason += f" {when}" if when else f", which {work} does not hold; {holds}"
        names = tuple(self.prefix + name for name in way)
        marking = {self.prefix + place: count for place, count in tokens.items() if count}
        self.found[t.origin] = Counterexample("unheld", reason, names, marking)

    def _kept_by(self, transition: str) -> frozenset[str]:
        """Return the single-token resources held during the action, by invariants of the net."""
        if self._kept is None:
            self._kept = self._find_kept()
        return self._kept.get(transition, frozenset())

    def _find_kept(self) -> Mapping[str, frozenset[str]]:
        compiled = compile_net(_losing(self.whole))
        kept: dict[str, set[str]] = {}
        for flow in p_semiflows(compiled, deadline=self.deadline).flows:
            marked = {place: self.whole.places[place].tokens for place in flow if self.whole.places[place].tokens}
            for place in marked.keys() & self.own:
                if marked != {place: 1}:
                    continue
                for origin in self.begins:
                    phases = (active_place(origin), cancelling_place(origin), doubt_place(origin))
                    if all(flow.get(phase, 0) >= flow[place] for phase in phases):
                        kept.setdefault(origin, set()).add(place)
        return {origin: frozenset(places) for origin, places in kept.items()}


def _losing(net: Net) -> Net:
    """Return a net in which emptied places may lose the tokens at any time, without reset arcs."""
    emptied = dict.fromkeys(place for t in net.transitions.values() for place in t.resets)
    lost = {f"{place} loses": Transition(f"{place} loses", {place: 1}) for place in emptied}
    kept = {name: replace(t, resets=()) for name, t in net.transitions.items()}
    return replace(net, transitions={**kept, **lost})
