"""Assumptions of nets on each other: behaviour of absent partners, and duties of present ones.

Alone, a net whose file says ``assume: {p: {at_most: n}}`` has partners who mark ``p`` at any time, as long as no more
than n tokens are there: the others wait in ``p.partner``. With ``assume: {p: {returns: b.q}}`` a token that it sends to
``b.q`` is on ``p.owed``, and comes to ``p`` from there.

Where partners are given, they do what they do, and places count it: ``p.at_most`` the tokens under way to ``p`` or in
it, and ``p.owed`` those that were sent and have not come back. More than n is a broken promise, and so is a token that
can never come back, or one that comes back and was not sent: that goes to ``p.unasked``, once.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from im_pnt.model.net import Net, Place, RemotePlace, Role, Transition
from im_pnt_analysis.composition.flat_net import FlatNet


@dataclass(frozen=True, slots=True)
class _Count:
    """Counting place: the raising and lowering transitions, by weight.

    Attributes:
        name: Its qualified name.
        raised_by: Places; each token given to one of them, on its way there, raises it.
        lowered_by: Places; each token taken from one of them lowers it.
    """

    name: str
    raised_by: str | None = None
    lowered_by: str | None = None


@dataclass(frozen=True, slots=True)
class _Debt:
    """Tokens sent to a place of another net, and returned from there.

    Attributes:
        net: Who sends it.
        target: Where to.
        owed: Qualified name of the place that counts it.
        back: Qualified name of the place from where it comes back; None: nobody is watched.
        kept: Qualified name of the place that is marked until one comes back that was not sent.
        unasked: Qualified name of the place that is marked from then on.
    """

    net: str
    target: RemotePlace
    owed: str
    back: str | None = None
    kept: str = ""
    unasked: str = ""


class Assumptions:
    """Additions to a composition for the assumptions of the nets.

    Attributes:
        promises: For places with a capacity that is a promise, what is said when it is broken; ``{tokens}`` in it.
        debts: For places that must always be able to become empty again, what is said when they cannot.
        watching: Transitions that fire only where a promise is broken.
        settled: Remote places of which it is said where their tokens come from: net and place.
    """

    def __init__(self, flat: FlatNet) -> None:
        self._flat = flat
        self._fed = {
            target for net in flat.nets.values() for t in net.transitions.values() for target in t.remote_outputs
        }
        self._counts: list[_Count] = []
        self._debts: list[_Debt] = []
        self.promises: dict[str, str] = {}
        self.debts: dict[str, str] = {}
        self.watching: set[str] = set()
        self.settled: set[tuple[str, str]] = set()
        for net in flat.nets.values():
            for name, assumption in net.assume.items():
                if name in net.services:
                    continue
                if assumption.returns is not None:
                    self._rely(net, net.places[name], assumption.returns)
                elif assumption.at_most is not None:
                    self._limit(net, net.places[name], assumption.at_most)

    def kept(self, net: Net, written: Transition, part: Transition) -> Iterator[Transition]:
        """Return a transition with the counters of the promises, in all ways to keep or break promises."""
        inputs, outputs = dict(part.inputs), dict(part.outputs)
        for count in self._counts:
            _add(outputs, count.name, part.outputs.get(count.raised_by or "", 0))
            lowers = part.inputs.get(count.lowered_by or "", 0)
            _add(inputs if count.name in self.promises else outputs, count.name, lowers)
        for debt in self._debts:
            if debt.net == net.name:
                _add(outputs, debt.owed, written.remote_outputs.get(debt.target, 0))
        parts = [replace(part, inputs=inputs, outputs=outputs)]
        for debt in self._debts:
            if debt.back is not None and (weight := part.outputs.get(debt.back, 0)):
                parts = [each for one in parts for each in self._returning(one, debt, weight)]
        yield from parts

    def _returning(self, part: Transition, debt: _Debt, weight: int) -> Iterator[Transition]:
        """Return a transition with returned tokens: from the place of sending, and without one."""
        yield replace(part, inputs={**part.inputs, debt.owed: weight})
        outputs = {place: tokens for place, tokens in part.outputs.items() if place != debt.back}
        unasked = f"{part.name} unasked"
        self.watching.add(unasked)
        yield replace(
            part,
            name=unasked,
            inputs={**part.inputs, debt.kept: 1},
            outputs={**outputs, debt.unasked: 1},
            inhibitors={**part.inhibitors, debt.owed: weight},
        )

    def _limit(self, net: Net, place: Place, most: int) -> None:
        flat, name = self._flat, self._flat.qualified(net.name, place.name)
        if RemotePlace(net.name, place.name) in self._fed:
            count = f"{name}.at_most"
            flat.add_place(net.name, Place(count, tokens=place.tokens, capacity=most))
            self.promises[count] = (
                f"net {net.name} assumes at most {most} tokens under way to {place.name} or in it, "
                "and other nets bring it to {tokens}"
            )
            self._counts.append(_Count(count, flat.underway_name(net.name, place.name), name))
        else:
            self.settled.add((net.name, place.name))
            count = f"{name}.partner"
            flat.add_place(net.name, Place(count, tokens=most - place.tokens))
            arrival = Transition(
                flat.qualified(net.name, f"arrive.{place.name}"), {count: 1}, {name: 1}, origin=place.name
            )
            flat.add_environment(arrival)
            self._counts.append(_Count(count, None, name))
            flat.assume(f"other nets have at most {most} tokens under way to {name} or in it (assume)")
        flat.rest.add(count)

    def _rely(self, net: Net, place: Place, target: RemotePlace) -> None:
        flat, name = self._flat, self._flat.qualified(net.name, place.name)
        owed = f"{name}.owed"
        if target.net in flat.nets:
            self.settled.add((net.name, place.name))
            kept, unasked = f"{name}.kept", f"{name}.unasked"
            flat.add_place(net.name, Place(owed))
            flat.add_place(net.name, Place(kept, tokens=1))
            flat.add_place(net.name, Place(unasked, capacity=0))  # one token in it refuses the net
            flat.rest.update((owed, kept))
            self.promises[unasked] = (
                f"net {net.name} assumes that {place.name} gets back what it has sent to {target}, "
                "and it gets a token that it has not sent"
            )
            self.debts[owed] = (
                f"net {net.name} assumes that what it has sent to {target} comes back in {place.name}, "
                "and after this it never all does"
            )
            self._debts.append(_Debt(net.name, target, owed, flat.underway_name(net.name, place.name), kept, unasked))
        elif RemotePlace(net.name, place.name) in self._fed:
            flat.assume(f"net {target.net}, of which net {net.name} assumes something, is left out")
        else:
            self.settled.add((net.name, place.name))
            flat.add_place(net.name, Place(owed))
            arrival = flat.qualified(net.name, f"arrive.{place.name}")
            flat.add_transition(Transition(arrival, {owed: 1}, {name: 1}, role=Role.ENVIRONMENT, origin=place.name))
            self._debts.append(_Debt(net.name, target, owed))
            flat.assume(f"each token that net {net.name} sends to {target} comes back in {name} (assume)")


def _add(arcs: dict[str, int], place: str, weight: int) -> None:
    if weight:
        arcs[place] = arcs.get(place, 0) + weight
