"""Steady state of a generalised stochastic Petri net: how often, how full, how busy, on the long average.

Vanishing markings take no time, but tokens pass through them: they are states whose rates are weights, and are
eliminated from the chain like any other state, loops among them included. Sources: Ajmone Marsan et al., "Modelling
with Generalized Stochastic Petri Nets", 1995, chapter 6; Molloy, IEEE Trans. Computers C-31(9), 1982.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from im_core.clock import monotonic
from im_pnt.errors import NetError
from im_pnt.model.net import Net
from im_pnt_analysis.timed.chain import Markings, chain, class_measure, class_probabilities, reach, recurrent_classes
from im_pnt_analysis.timed.model import timed_net

_MARKINGS_KEPT = 10_000
_EMPTY = 1e-12
"""Shares of the time below this are errors of rounding."""


@dataclass(frozen=True, slots=True)
class RecurrentClass:
    """Recurrent markings.

    Attributes:
        probability: How likely the net ends up in it.
        markings: Tangible markings of it.
        dead: Whether it is one marking that nothing leads out of.
        marking: One of its tangible markings.
    """

    probability: float
    markings: int
    dead: bool
    marking: dict[str, int]


@dataclass(frozen=True, slots=True)
class SteadyState:
    """Long averages.

    Attributes:
        tangible: float of markings in which time passes.
        vanishing: float of markings that are left at once.
        probability: Tangible markings and their share of the time, those of no share left out; empty where there are
            more than 10,000.
        throughput: Firings of each transition a second [1/s].
        mean_tokens: Mean tokens of each place.
        marked: For each place the share of the time in which it holds tokens: its utilisation.
        busy: For each transition that takes time the share of the time in which it is enabled, or its action runs.
        tokens: For each place the share of the time of each number of tokens.
        classes: The recurrent classes that can be reached.
        method: How it was computed.
        assumptions: What is taken for granted.
        time_s: How long it took [s].
    """

    tangible: int
    vanishing: int
    probability: Sequence[tuple[dict[str, int], float]]
    throughput: Mapping[str, float]
    mean_tokens: Mapping[str, float]
    marked: Mapping[str, float]
    busy: Mapping[str, float]
    tokens: Mapping[str, Mapping[int, float]]
    classes: Sequence[RecurrentClass]
    method: str
    assumptions: tuple[str, ...]
    time_s: float


def steady_state(nets: Sequence[Net], *, seconds: float = 60.0, states: int = 1_000_000) -> SteadyState:
    """Compute the steady state of nets composed with the environment.

    Exact for exponential delays, and for any others of transitions that never run beside another one: there the means
    decide (semi-Markov process).

    Args:
        nets: The nets.
        seconds: CPU time for the search of the markings [s].
        states: Markings at most.

    Raises:
        NetError: The nets do not fit together, a delay is of another kind, nothing takes time, immediate transitions
            go round for ever, or there are too many markings.

    >>> averages = steady_state([oven])
    >>> round(averages.throughput["bake"], 12), round(averages.marked["full"], 12)
    (0.2, 0.8)
    """
    begin = monotonic()
    if not seconds > 0.0:
        raise NetError(f"{seconds} is not a time for the search; a number > 0 is needed [s]")
    net = timed_net(nets)
    if not net.timers:
        raise NetError(f"no transition of {net.compiled.net.name} has a delay, so that there is no time to divide by")
    found = reach(net, states=states, seconds=seconds)
    require_computable(found)
    return _solve(found, begin)


def require_computable(found: Markings) -> None:
    """Check whether rates, or means alone, decide about each marking.

    Raises:
        NetError: Delays that are not exponential run beside others; names them.
    """
    if not found.rivals:
        return
    timers = [found.net.timers[timer] for timer in sorted(found.rivals)]
    names = ", ".join(f"{timer.name} ({timer.delay})" for timer in timers)
    raise NetError(
        f"the steady state can be computed for exponential delays only, or where one thing happens at a time; {names} "
        "run beside others. 'scripts/im pnt simulate --summary' estimates it by simulation",
        transitions=[timer.name for timer in timers],
    )


def _solve(found: Markings, begin: float) -> SteadyState:
    net = found.net
    links = chain(found)
    classes = recurrent_classes(found)
    likely = class_probabilities(links, classes)
    measure: dict[int, float] = {}
    methods: dict[str, None] = {}
    for members, share in zip(classes, likely, strict=True):
        if share:  # a class that is never reached adds nothing, and its equations may be the longest
            part, method = class_measure(links, members)
            measure.update((state, value * share) for state, value in part.items())
            methods[method] = None
    throughput = dict.fromkeys(net.shown, 0.0)
    mean = dict.fromkeys(net.shown_places, 0.0)
    tokens: dict[str, dict[int, float]] = {name: {} for name in net.shown_places}
    busy = {timer.name: 0.0 for timer in net.timers}
    probability: list[tuple[dict[str, int], float]] = []
    plain = [(timer.name, timer.outcomes[0][0][0]) for timer in net.timers if timer.active is None]
    actions = [(timer.name, timer.active) for timer in net.timers if timer.active is not None]
    for state, share in measure.items():
        for transition, _, rate in links.firings[state]:
            throughput[net.shown[transition]] += share * rate
        if not found.tangible[state]:
            continue  # vanishing: it fires, but no time passes in it
        marking = net.marking(found.vectors[state])
        if len(measure) <= _MARKINGS_KEPT:
            probability.append((marking, share))
        for place, count in marking.items():
            mean[place] += share * count
            tokens[place][count] = tokens[place].get(count, 0.0) + share
        firing = {transition for transition, _, _ in links.firings[state]}
        for name, transition in plain:
            if transition in firing:
                busy[name] += share
        for name, active in actions:
            if found.vectors[state][active]:
                busy[name] += share
    marked = {place: sum(shares.values(), start=0.0) for place, shares in tokens.items()}
    for place, shares in tokens.items():
        if 1.0 - marked[place] > _EMPTY:  # markings name marked places only: the rest of the time the place is empty
            shares[0] = 1.0 - marked[place]
    tangible = sum(found.tangible)
    return SteadyState(
        tangible,
        len(found.vectors) - tangible,
        probability,
        throughput,
        mean,
        marked,
        busy,
        tokens,
        [
            RecurrentClass(
                share,
                sum(found.tangible[state] for state in members),
                not found.arcs[members[0]],
                net.marking(found.vectors[members[0]]),
            )
            for members, share in zip(classes, likely, strict=True)
        ],
        "; ".join(methods),
        net.assumptions,
        monotonic() - begin,
    )
