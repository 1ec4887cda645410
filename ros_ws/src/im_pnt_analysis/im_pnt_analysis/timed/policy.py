"""Policy of a timed net: which of contending transitions to take in which marking, for the most reward.

The markings are the states of a decision process: time passes in tangible ones, as rates say; in a vanishing one of the
transitions that contend for a token is taken, by choice or by weight. The optimum is found by policy iteration (R. A.
Howard, "Dynamic Programming and Markov Processes", 1960). Where a policy on the way never ends, or divides the markings
into classes, it is found by linear programming over how often each choice is made (L. C. M. Kallenberg, "Linear
Programming and Finite Markovian Control Problems", 1983). Nets with rewards and choices are the GSPNR of C. Azevedo,
A. Matos, P. U. Lima and J. Avendano, "Petri Net Toolbox for Multi-Robot Planning under Uncertainty" (2021).
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.model.net import Net, Role, Transition
from im_pnt_analysis.timed.chain import RENEWAL, Markings, chain, reach
from im_pnt_analysis.timed.model import TimedNet, timed_net
from im_pnt_analysis.timed.steady import require_computable

_SHARE = 1e-9
"""Choices that are made less often are errors of rounding."""
_ROUNDS = 100
"""Most improvements of a policy, which take ten as a rule."""
_NEVER = 1e-6
"""Weight of a transition that is never chosen: none may be 0."""
_PHASES = {"": ("", ".end", ".end.cancelling"), "+": (".start",), "!": (".failed", ".failed.cancelling")}
"""Endings of names of expanded transitions, for the marks of firings as in scenarios."""


@dataclass(frozen=True, slots=True)
class Rewards:
    """Rewards of a net; costs are negative.

    Attributes:
        firings: For each firing of a transition: ``t`` ended well, ``t+`` has begun, ``t!`` has failed.
        seconds: For each token of a place and each second [1/s].
        second: For each second [1/s].
    """

    firings: Mapping[str, float]
    seconds: Mapping[str, float]
    second: float = 0.0


@dataclass(frozen=True, slots=True)
class Decision:
    """Decision in a marking.

    Attributes:
        marking: The marking.
        options: Transitions that contend there, each with the share of the times that it is chosen.
        often: How often it is made: in one command, or a second [1/s].
    """

    marking: Mapping[str, int]
    options: Mapping[str, float]
    often: float


@dataclass(frozen=True, slots=True)
class BestPolicy:
    """Policy and its value.

    Attributes:
        value: Reward with the best choices: of one command, or a second [1/s].
        present: Reward with the weights as they are.
        weighted: Reward with :attr:`weights`, which know no markings.
        decisions: Decisions that are made, the most frequent first.
        weights: Weight of each transition that is chosen or left, as often as the policy takes it.
        assumptions: What is taken for granted.
    """

    value: float
    present: float
    weighted: float
    decisions: tuple[Decision, ...]
    weights: Mapping[str, float]
    assumptions: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Option:
    """Way to leave a state.

    Attributes:
        taken: Transition of the choice, as written; empty: there is none to make.
        targets: States with the probabilities; none: the command has ended.
        reward: Expected reward.
        time: Expected time [s].
        weight: Weight of the choice.
    """

    taken: str
    targets: Mapping[int, float]
    reward: float
    time: float
    weight: float = 1.0


_MOST_STATES, _SEARCH_S = 20_000, 60.0
"""Limits of the search of the markings: their number, and CPU time [s]."""


def best_policy(
    nets: Sequence[Net],
    rewards: Rewards,
    *,
    command: str | None = None,
    chosen: Collection[str] | None = None,
) -> BestPolicy:
    """Compute the choices with the most reward: of one command from symbol to answer, or a second in the long run.

    Args:
        nets: The nets, composed with the environment.
        rewards: What is to be gained.
        command: Symbol of the command; None: the long run.
        chosen: Transitions that are chosen; None: all that have neither guard nor symbol nor delay nor another weight
            than 1, or have a strategy.

    Raises:
        NetError: The nets do not fit together, a name is not known, a delay is of a kind that cannot be computed, the
            command may never end, or there are too many markings.
    """
    net = timed_net(nets, command=command)
    found = reach(net, states=_MOST_STATES, seconds=_SEARCH_S)
    require_computable(found)
    process = _Process(net, found, rewards, chosen)
    best, occupied = _solved(process.options, ending=command is not None)
    present, _ = _solved(process.weighted(None), ending=command is not None)
    decisions = sorted(process.decisions(occupied), key=lambda each: -each.often)
    weights = _weights(decisions)
    weighted, _ = _solved(process.weighted(weights), ending=command is not None)
    return BestPolicy(best, present, weighted, tuple(decisions), weights, net.assumptions)


class _Process:
    """Decision process of a timed net.

    Attributes:
        options: For each marking the ways to leave it.
    """

    def __init__(self, net: TimedNet, found: Markings, rewards: Rewards, chosen: Collection[str] | None) -> None:
        self._net, self._found, self._rewards = net, found, rewards
        self._transitions = list(net.compiled.net.transitions.values())
        self._written = [_as_written(name, t) for name, t in zip(net.shown, self._transitions, strict=True)]
        self._places = [frozenset(place for place, _ in arcs) for arcs in net.compiled.inputs]
        known = dict.fromkeys(name for name, t in zip(self._written, self._transitions, strict=True) if _chooses(t))
        for name in chosen or ():
            if name not in known:
                raise NetError(f"there is no transition '{name}' that could be chosen{nearest(name, known)}")
        usual = (
            name for name, t in zip(self._written, self._transitions, strict=True) if t.weight == 1.0 or t.strategy
        )
        self._chosen = frozenset(known) & frozenset(usual if chosen is None else chosen)
        self._gains = self._gained()
        rates = chain(found).firings
        self.options = [list(self._options(state, rates[state])) for state in range(len(found.vectors))]

    def _gained(self) -> list[float]:
        """Return the reward of each transition of the flat net."""
        gains = [0.0] * len(self._net.shown)
        for name, value in self._rewards.firings.items():
            mark = name[-1:] if name[-1:] in _PHASES else ""
            of = {f"{name.removesuffix(mark)}{phase}" for phase in _PHASES[mark]}
            ranks = [rank for rank, shown in enumerate(self._net.shown) if shown in of]
            if not ranks:
                raise NetError(f"there is no transition '{name.removesuffix(mark)}'{nearest(name, self._written)}")
            for rank in ranks:
                gains[rank] += value
        for place in self._rewards.seconds:
            if place not in self._net.shown_places:
                raise NetError(f"there is no place '{place}'{nearest(place, self._net.shown_places)}")
        return gains

    def _options(self, state: int, rates: Sequence[tuple[int, int, float]]) -> Iterator[_Option]:
        """Yield the ways to leave a marking."""
        if any(transition == RENEWAL for transition, _, _ in rates):
            yield _Option("", {}, 0.0, 0.0)
        elif self._found.tangible[state]:
            marking = self._net.marking(self._found.vectors[state])
            here = self._rewards.seconds
            rate = self._rewards.second + sum(here[name] * count for name, count in marking.items() if name in here)
            if not rates:  # dead: time goes on
                yield _Option("", {state: 1.0}, rate, 1.0)
            else:
                drawn, time = self._drawn(rates), 1.0 / sum(each for _, _, each in rates)
                yield _Option("", drawn.targets, drawn.reward + rate * time, time)
        else:
            contending = self._contending(rates)
            names = [self._written[transition] for transition, _, _ in contending]
            if len(contending) < 2 or not self._chosen.issuperset(names):
                yield self._drawn(contending)
                return
            for name in dict.fromkeys(names):
                own = [each for each, other in zip(contending, names, strict=True) if other == name]
                whole = sum(weight for _, _, weight in own)
                option = self._drawn(own)
                yield _Option(name, option.targets, option.reward, 0.0, whole)

    def _contending(self, firings: Sequence[tuple[int, int, float]]) -> list[tuple[int, int, float]]:
        """Return the first firing with those that contend with it, directly or over others; the rest comes later."""
        group, places = [firings[0]], set(self._places[firings[0][0]])
        while more := [each for each in firings if each not in group and places & self._places[each[0]]]:
            group += more
            places.update(*(self._places[transition] for transition, _, _ in more))
        return group

    def _drawn(self, firings: Sequence[tuple[int, int, float]]) -> _Option:
        """Return the way of firings that rates or weights decide about."""
        whole = sum(weight for _, _, weight in firings)
        targets: dict[int, float] = {}
        for _, target, weight in firings:
            targets[target] = targets.get(target, 0.0) + weight / whole
        gained = sum(self._gains[transition] * weight / whole for transition, _, weight in firings)
        return _Option("", targets, gained, 0.0)

    def weighted(self, weights: Mapping[str, float] | None) -> list[list[_Option]]:
        """Return the options with all choices left to weights: given ones, or those of the net."""
        if weights is None:
            return [[_mixed(options, [option.weight for option in options])] for options in self.options]
        return [[_mixed(options, [weights.get(option.taken, 1.0) for option in options])] for options in self.options]

    def decisions(self, made: Sequence[tuple[Sequence[float], float]]) -> Iterator[Decision]:
        """Yield the decisions that are made, from the shares of the options and how often each state is left."""
        for state, (options, (shares, often)) in enumerate(zip(self.options, made, strict=True)):
            if len(options) > 1 and shares:
                taken = {option.taken: share for option, share in zip(options, shares, strict=True)}
                yield Decision(self._net.marking(self._found.vectors[state]), taken, often)


def _mixed(options: Sequence[_Option], weights: Sequence[float]) -> _Option:
    """Return the way of options that weights decide about."""
    whole, targets = sum(weights), dict[int, float]()
    for option, weight in zip(options, weights, strict=True):
        for target, likely in option.targets.items():
            targets[target] = targets.get(target, 0.0) + likely * weight / whole
    reward = sum(option.reward * weight for option, weight in zip(options, weights, strict=True)) / whole
    return _Option("", targets, reward, options[0].time)


_Solution = tuple[float, list[tuple[list[float], float]]]
"""The reward, and for each state the shares of its options (none where it is not met) and how often it is left."""


def _solved(options: Sequence[Sequence[_Option]], *, ending: bool) -> _Solution:
    """Maximise the reward from the first state on: the total until the end, or the average a second [1/s].

    Raises:
        NetError: There is no end, or no limit.
    """
    improved = _improved(options, ending=ending)
    return _programmed(options, ending=ending) if improved is None else improved


def _improved(options: Sequence[Sequence[_Option]], *, ending: bool) -> _Solution | None:
    """Improve a policy until nothing is better (policy iteration); None where one on the way has no single value."""
    taken = [_mixed(each, [option.weight for option in each]) for each in options]
    ranks: list[int] = []
    for _ in range(_ROUNDS):
        if (found := _evaluated(taken, ending=ending)) is None:
            return None
        average, values, visits = found
        slack = _SHARE * (1.0 + max(map(abs, values)))
        better: list[int] = []
        for state, each in enumerate(options):
            worth = [
                option.reward - average * option.time + sum(p * values[to] for to, p in option.targets.items())
                for option in each
            ]
            best = max(worth)
            keeps = bool(ranks) and worth[ranks[state]] >= best - slack
            better.append(ranks[state] if keeps else worth.index(best))
        if better == ranks:
            shares = [
                [float(rank == own) for rank in range(len(each))] for own, each in zip(ranks, options, strict=True)
            ]
            made = [(share if often > _SHARE else [], often) for share, often in zip(shares, visits, strict=True)]
            return average if not ending else values[0], made
        ranks = better
        taken = [each[rank] for each, rank in zip(options, ranks, strict=True)]
    return None


def _evaluated(taken: Sequence[_Option], *, ending: bool) -> tuple[float, list[float], list[float]] | None:
    """Return the average a second, the value of each state, and how often each is left, for one option each.

    None: states fall apart into classes, or there is no end.
    """
    import numpy as np
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu

    entries: dict[tuple[int, int], float] = {(state, state): 1.0 for state in range(len(taken))}
    for state, option in enumerate(taken):
        for target, likely in option.targets.items():
            entries[state, target] = entries.get((state, target), 0.0) - likely
    if not ending:  # the value of the first state is 0, and the average stands in its place
        entries = {at: value for at, value in entries.items() if at[1]}
        entries |= {(state, 0): option.time for state, option in enumerate(taken)}
    rows, columns = zip(*entries, strict=True)
    matrix = csc_matrix((list(entries.values()), (rows, columns)), (len(taken), len(taken)))
    rewards, first = np.array([option.reward for option in taken]), np.eye(1, len(taken))[0]
    try:
        factors = splu(matrix)
    except RuntimeError:  # it is singular
        return None
    values, visits = factors.solve(rewards), factors.solve(first, trans="T")
    wrong = float(np.max(np.abs(matrix @ values - rewards))) + float(np.max(np.abs(matrix.T @ visits - first)))
    scale = 1.0 + float(np.max(np.abs(rewards)))
    if not np.isfinite(wrong) or wrong > 1e-7 * scale or float(np.min(visits)) < -1e-7 * (1.0 + float(np.max(visits))):
        return None
    average = 0.0 if ending else float(values[0])
    values[0] = values[0] if ending else 0.0
    return average, values.tolist(), visits.tolist()


def _programmed(options: Sequence[Sequence[_Option]], *, ending: bool) -> _Solution:
    """Maximise the reward by linear programming, whatever classes a policy has.

    Raises:
        NetError: There is no end, or no limit.
    """
    from scipy.optimize import linprog
    from scipy.sparse import bmat, coo_matrix

    flat = [(state, option) for state, each in enumerate(options) for option in each]
    unit = max((option.time for _, option in flat), default=0.0) or 1.0
    gain = max((abs(option.reward) for _, option in flat), default=0.0) or 1.0
    rows, columns, values = list[int](), list[int](), list[float]()
    for column, (state, option) in enumerate(flat):
        flow = {state: 1.0}
        for target, likely in option.targets.items():
            flow[target] = flow.get(target, 0.0) - likely
        rows += list(flow)
        columns += [column] * len(flow)
        values += flow.values()
    flows = coo_matrix((values, (rows, columns)), (len(options), len(flat)))
    first = [1.0] + [0.0] * (len(options) - 1)
    rewards = [-option.reward / gain for _, option in flat]
    if ending:
        solved = linprog(rewards, A_eq=flows, b_eq=first, method="highs")
    else:
        states, ranks = [state for state, _ in flat], range(len(flat))
        times = coo_matrix(([option.time / unit for _, option in flat], (states, ranks)), flows.shape)
        both = bmat([[flows, None], [times, flows]])
        ends = [0.0] * len(options) + first
        solved = linprog(rewards + [0.0] * len(flat), A_eq=both, b_eq=ends, method="highs")
    if solved.status == 2 and not ending:
        raise NetError("whatever is chosen, no time passes: there is no average a second")
    if solved.status == 2:
        raise NetError("whatever is chosen, the command may never end: what it would gain until then cannot be told")
    if solved.status == 3:
        raise NetError("there is no limit to what can be gained: choices go round and gain without time passing")
    if solved.x is None:
        raise NetError(f"the best choices could not be computed: {solved.message}")
    made: list[tuple[list[float], float]] = []
    at = 0
    for each in options:
        often = [float(value) for value in solved.x[at : at + len(each)]]
        passing = [] if ending else [float(value) for value in solved.x[len(flat) + at : len(flat) + at + len(each)]]
        met = next((some for some in (often, passing) if sum(some) > _SHARE), [])
        made.append(([value / sum(met) for value in met], sum(often) / (1.0 if ending else unit)))
        at += len(each)
    return -float(solved.fun) * gain / (1.0 if ending else unit), made


def _chooses(transition: Transition) -> bool:
    """Whether a transition could be chosen: it fires at once, and nothing else decides."""
    free = transition.guard is None and transition.symbol is None and transition.role in (Role.PLAIN, Role.START)
    return free and (transition.role is Role.START or transition.delay is None or not transition.delay.mean)


def _as_written(shown: str, transition: Transition) -> str:
    return shown.removesuffix(".start") if transition.role is Role.START else shown


def _weights(decisions: Sequence[Decision]) -> dict[str, float]:
    """Return weights after how often each transition is chosen; the largest of those that contend is 1."""
    counts: dict[str, float] = {}
    for decision in decisions:
        for name, share in decision.options.items():
            counts[name] = counts.get(name, 0.0) + share * (decision.often or _SHARE)
    largest = dict(counts)
    for decision in [*decisions] * len(decisions):  # those that contend over others have the largest of all
        top = max(largest[name] for name in decision.options)
        largest.update(dict.fromkeys(decision.options, top))
    return {name: max(float(f"{count / largest[name]:.4g}"), _NEVER) for name, count in counts.items()}
