"""Stand-in nets for the writers to tapes of others, for a verification without the writers.

A free tape asks for no reply. Who writes a command for another net waits for one: a net that reads it and never ends it
is found only with somebody who waits.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import linprog

from im_pnt.model.action import RequestAction
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import active_place
from im_pnt.model.net import Net, Place, Transition
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.structure.semiflows import p_semiflows


class Callers:
    """Writers to tapes of others.

    Args:
        nets: All nets, as written.
    """

    def __init__(self, nets: Sequence[Net]) -> None:
        self._nets = nets
        self._flows: dict[str, _Flows] = {}

    def of(self, part: Sequence[Net]) -> list[Net] | None:
        """Return nets with the writes of the absent nets to the tapes of a part: at any time, as often as possible.

        Args:
            part: Some of the nets.

        Returns:
            A net for each that writes; None where it is not known how often at once one of them can.
        """
        inside = {net.name: net for net in part}
        found = []
        for net in self._nets:
            asking = [] if net.name in inside else _tape_requests(net, inside)
            if asking:
                if net.name not in self._flows:
                    self._flows[net.name] = _Flows(net)
                standing = _standing_for(net, asking, self._flows[net.name])
                if standing is None:
                    return None
                found.append(standing)
        return found


def _tape_requests(net: Net, asked: dict[str, Net]) -> list[Transition]:
    """Return the transitions of a net with writes to tapes."""
    found = []
    for transition in net.transitions.values():
        match transition.action:
            case RequestAction(net=other, service=symbol) if other in asked and symbol not in asked[other].services:
                found.append(transition)
    return found


def _standing_for(net: Net, asking: Sequence[Transition], flows: "_Flows") -> Net | None:
    """Return one transition for all with the same write and wait: the answers are exchangeable."""
    alike: dict[tuple[str, float | None], list[Transition]] = {}
    for each in asking:
        alike.setdefault((str(each.action), each.timeout), []).append(each)
    places: dict[str, Place] = {}
    transitions: dict[str, Transition] = {}
    for (_, timeout), group in alike.items():
        most = flows.most(active_place(each.name) for each in group)
        if most is None:
            return None
        name, idle = group[0].name, f"idle_{group[0].name}"
        places[idle] = Place(idle, tokens=most)
        transitions[name] = Transition(
            name,
            inputs={idle: 1},
            outputs={idle: 1},
            symbol=name,
            action=group[0].action,
            on_failure={idle: 1},
            timeout=timeout,
            origin=name,
        )
    return Net(net.name, places, transitions, source=net.source)


class _Flows:
    """Statements of the P-semiflows of a net, alone, on several places together."""

    def __init__(self, net: Net) -> None:
        compiled = compile_net(compose([net]).net)
        flows = p_semiflows(compiled).flows
        initial = compiled.net.initial_marking()
        self._rank = {name: rank for rank, name in enumerate(compiled.places)}
        self._weights = np.zeros((len(flows), len(self._rank)))
        for row, flow in enumerate(flows):
            for place, weight in flow.items():
                self._weights[row, self._rank[place]] = weight
        self._sums = [sum(weight * initial.get(place, 0) for place, weight in flow.items()) for flow in flows]

    def most(self, places: Iterable[str]) -> int | None:
        """Return a bound on the tokens of places together, by linear programming; None: there is none."""
        wanted = np.zeros(len(self._rank))
        wanted[[self._rank[place] for place in places]] = -1.0
        if not self._sums:
            return None
        found = linprog(wanted, A_eq=self._weights, b_eq=self._sums, bounds=(0, None))
        return math.floor(1e-6 - found.fun) if found.status == 0 else None
