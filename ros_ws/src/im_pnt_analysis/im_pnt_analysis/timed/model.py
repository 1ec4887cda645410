"""Composition as a stochastic process: delays, immediate firings, and frequencies of alternatives.

Generalised stochastic Petri nets (Ajmone Marsan, Balbo, Conte, 1984) with actions. An action runs once for each token
on its ``t.active`` place, then ends or fails by its ``success``. The time of a transition without an action starts when
it becomes enabled and is forgotten when it is disabled (race, enabling memory); with several ``servers`` such a time
runs for each of its tokens, and where tokens leave the times that began last are forgotten.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.execution.jobs import ends
from im_pnt.model.action import AwaitAction, RequestAction
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.delay import Delay
from im_pnt.model.net import Net, Place, Role, Transition
from im_pnt_analysis.composition.compose import Composition, compose

_SUFFIX = ".failed"


def tell_outcomes_apart(flat: Net) -> tuple[Net, Mapping[str, str], Mapping[str, str]]:
    """Split the replies to requests, for services and for commands, into done and failed.

    Returns:
        The net, and for each transition and each place that was added the one it was split from.
    """
    services, commands = _shared_replies(flat), _command_replies(flat)
    split = services | commands.keys()
    if not split:
        return flat, {}, {}

    def apart(arcs: Mapping[str, int], places: Collection[str] = split) -> dict[str, int]:
        return {f"{name}{_SUFFIX}" if name in places else name: weight for name, weight in arcs.items()}

    transitions: dict[str, Transition] = {}
    shown: dict[str, str] = {}
    for name, whole in flat.transitions.items():
        refused = {
            place
            for place in whole.outputs.keys() & commands.keys()
            if any(ends(emitted, commands[place]) is False for emitted in whole.emit)
        }
        transition = replace(whole, outputs=apart(whole.outputs, refused)) if refused else whole
        match transition.role:
            case Role.FINISH_FAILED:
                transitions[name] = replace(transition, outputs=apart(transition.outputs))
            case Role.FAILED:
                transitions[name] = replace(transition, inputs=apart(transition.inputs))
            case Role.RETURN:
                transitions[name] = transition
                twin = f"{name}{_SUFFIX}"  # the caller takes either reply: one transition for each
                shown[twin] = name
                inputs, outputs = apart(transition.inputs), apart(transition.outputs)
                transitions[twin] = replace(transition, name=twin, inputs=inputs, outputs=outputs)
            case _:
                transitions[name] = transition
    added = {f"{name}{_SUFFIX}": name for name in flat.places if name in split}
    places = {**flat.places, **{name: Place(name) for name in added}}
    return replace(flat, places=places, transitions=transitions), shown, added


def _command_replies(flat: Net) -> dict[str, str]:
    """Return the places with any answer to a command of another net, each with the command's symbol."""
    taken = [
        {place for t in flat.transitions.values() if t.role is role for place in t.inputs}
        for role in (Role.END, Role.FAILED)
    ]
    found: dict[str, str] = {}
    for start in flat.transitions.values():
        if start.role is Role.START and isinstance(start.action, RequestAction):
            for place in start.outputs:
                reply = f"{place.removesuffix('.active')}.reply"
                if place.endswith(".active") and all(reply in places for places in taken):
                    found[reply] = start.action.service
    return found


def _shared_replies(flat: Net) -> frozenset[str]:
    """Return the places with any reply: O.s, and the targets of RETURN at a caller's end and failure."""
    finished = {place for t in flat.transitions.values() if t.role is Role.FINISH for place in t.outputs}
    failed = {place for t in flat.transitions.values() if t.role is Role.FINISH_FAILED for place in t.outputs}
    returns = [t for t in flat.transitions.values() if t.role is Role.RETURN]
    taken = {place for t in returns for place in t.inputs}
    given = {place for t in returns for place in t.outputs}
    ends = {place for t in flat.transitions.values() if t.role is Role.END for place in t.inputs}
    failures = {place for t in flat.transitions.values() if t.role is Role.FAILED for place in t.inputs}
    return frozenset((finished & failed & taken) | (given & ends & failures))


_NEVER = (Role.CANCEL, Role.LOST, Role.GIVEN_UP)


@dataclass(frozen=True, slots=True)
class TimedActivity:
    """Activity with a duration.

    Attributes:
        name: The transition as written, qualified by its net where there are several.
        delay: Its time.
        active: Place with a token for each running action; None: a transition without action, which runs while enabled.
        outcomes: What may come of it, each with its probability: of the transitions given the first that may fire does.
            Several where an action answers whoever has asked for it: one for each of them, and one for nobody.
        servers: How many times run at once, of a transition without action.
    """

    name: str
    delay: Delay
    active: int | None
    outcomes: tuple[tuple[tuple[int, ...], float], ...]
    servers: int = 1


@dataclass(frozen=True, slots=True)
class TimedNet:
    """Timed net; transitions and places come from ``compiled``.

    Attributes:
        composition: The nets and their environment.
        compiled: The flat net, with the replies of services told apart.
        timers: What takes time.
        timer_of: For each transition the timer that it starts (action) or is (no action), else -1.
        levels: Transitions that fire at once, in groups of falling urgency; a later group waits for the earlier ones.
        waiting: Further such groups that wait until no time is running either: symbols and callers from outside.
        weight: For each transition how often it is taken among others of its group; those of weight 0 are a group that
            comes later.
        shown: For each transition its name in the composition.
        shown_places: For each place its name in the composition.
        ends: Places of which one is marked when the command has been answered: done, failed; None without a command.
        assumptions: What is taken for granted.
    """

    composition: Composition
    compiled: Compiled
    timers: tuple[TimedActivity, ...]
    timer_of: tuple[int, ...]
    levels: tuple[tuple[int, ...], ...]
    waiting: tuple[tuple[int, ...], ...]
    weight: tuple[float, ...]
    shown: tuple[str, ...]
    shown_places: tuple[str, ...]
    ends: tuple[int, int] | None
    assumptions: tuple[str, ...]

    @property
    def initial(self) -> tuple[int, ...]:
        """First tokens of each place."""
        return self.compiled.marking_vector(self.compiled.net.initial_marking())

    def marking(self, vector: Sequence[int]) -> dict[str, int]:
        """Return the marked places under the names in the composition."""
        marking: dict[str, int] = {}
        for name, count in zip(self.shown_places, vector, strict=True):
            if count:
                marking[name] = marking.get(name, 0) + count
        return marking


def timed_net(nets: Sequence[Net], *, failures: float = 0.0, command: str | None = None) -> TimedNet:
    """Make the stochastic process of nets composed with the environment.

    Args:
        nets: The nets.
        failures: Probability that an action without ``success`` fails.
        command: Symbol that is written to the tape once, and nothing else comes from outside; None: symbols and
            callers come as soon as the nets have nothing else to do.

    Raises:
        NetError: The nets do not fit together, a probability or weight that is none, or nobody reads the symbol.
    """
    if not 0.0 <= failures <= 1.0:
        raise NetError(f"{failures} is not a probability of failure; 0 to 1 is allowed")
    composition = compose(nets)
    flat, shown, shown_places = tell_outcomes_apart(composition.net)
    if command is not None:
        flat = _with_tape(flat, command)
    compiled = compile_net(flat)
    builder = _Builder(composition, compiled, failures, command)
    for index, transition in enumerate(flat.transitions.values()):
        builder.add(index, transition)
    levels = tuple(tuple(builder.levels[group]) for group in sorted(builder.levels, reverse=True))
    waiting = tuple(tuple(builder.waiting[group]) for group in sorted(builder.waiting, reverse=True))
    return TimedNet(
        composition,
        compiled,
        tuple(builder.timers),
        tuple(builder.timer_of),
        levels,
        waiting + ((tuple(builder.withdrawn),) if builder.withdrawn else ()),
        tuple(builder.weight),
        tuple(shown.get(name, name) for name in compiled.transitions),
        tuple(shown_places.get(name, name) for name in compiled.places),
        None if command is None else (len(compiled.places) - 2, len(compiled.places) - 1),
        tuple(builder.assumptions),
    )


def _with_tape(flat: Net, symbol: str) -> Net:
    """Put the symbol on a place read once, and mark another one after the answer of the command."""
    known = flat.symbols()
    if symbol not in known:
        raise NetError(f"no transition of {flat.name} reads the symbol '{symbol}'{nearest(symbol, known)}")
    tape = f"tape.{symbol}"
    answers = {f"{symbol}_done": f"tape.{symbol}_done", f"{symbol}_failed": f"tape.{symbol}_failed"}
    if not any(answers.keys() & set(t.emit) for t in flat.transitions.values()):
        raise NetError(f"no transition of {flat.name} emits {' or '.join(answers)}, so that {symbol} never ends")
    transitions = {}
    for name, transition in flat.transitions.items():
        inputs, outputs = dict(transition.inputs), dict(transition.outputs)
        if transition.symbol == symbol:
            inputs[tape] = 1
        for emitted in set(transition.emit) & answers.keys():
            outputs[answers[emitted]] = 1
        transitions[name] = replace(transition, inputs=inputs, outputs=outputs)
    added = {tape: Place(tape, tokens=1), **{place: Place(place) for place in answers.values()}}
    return replace(flat, places={**flat.places, **added}, transitions=transitions)


class _Builder:
    def __init__(self, composition: Composition, compiled: Compiled, failures: float, command: str | None) -> None:
        self.composition, self.failures, self.command = composition, failures, command
        self.number = {name: index for index, name in enumerate(compiled.places)}
        self.by_name = {name: index for index, name in enumerate(compiled.transitions)}
        self.transitions: Mapping[str, Transition] = compiled.net.transitions
        self.timers: list[TimedActivity] = []
        self.timer_of = [-1] * len(compiled.transitions)
        self.weight = [1.0] * len(compiled.transitions)
        self.levels: dict[tuple[int, bool], list[int]] = {}
        self.waiting: dict[tuple[int, bool], list[int]] = {}
        self.withdrawn: list[int] = []
        self.assumptions: dict[str, None] = {}
        self._probability: dict[int, float] = {}
        self._timed_ends: set[int] = set()
        self._timer_named: dict[str, int] = {}
        self._endings: dict[tuple[Role, str], list[int]] = {}
        calling_off = (t for t in self.transitions.values() if t.cancels is not None)
        self._called_off = {place for t in calling_off for place in t.inputs if place.endswith(".active")}
        for name, transition in self.transitions.items():
            if transition.role in (Role.END, Role.FAILED):
                for place in transition.inputs:
                    self._endings.setdefault((transition.role, place), []).append(self.by_name[name])

    def add(self, index: int, transition: Transition) -> None:
        """Decide on the kind of a transition of the flat net; START comes before the END and FAILED."""
        weight = self._probability.get(index)
        self.weight[index] = weight = self._weight(transition) if weight is None else weight
        if index in self._timed_ends or self._never(transition):
            return
        if transition.role is Role.START:
            self._start(index, transition)
        elif transition.role is Role.PLAIN and transition.delay is not None and transition.delay.mean > 0.0:
            if (meant := self.composition.ways.get(transition.name)) is not None:
                raise NetError(
                    f"transition {meant} has a delay and resets places, which timed analysis cannot follow; give the "
                    "resets to another transition, without delay"
                )
            self.timer_of[index] = len(self.timers)
            outcomes: tuple[tuple[tuple[int, ...], float], ...] = (((index,), 1.0),)
            activity = TimedActivity(transition.name, transition.delay, None, outcomes, transition.at_once)
            self.timers.append(activity)
            return
        if transition.role is Role.WITHDRAWN:
            self.withdrawn.append(index)
        elif transition.name in self.composition.external and self.command is None:
            self.waiting.setdefault((transition.priority, weight > 0.0), []).append(index)
        else:
            self.levels.setdefault((transition.priority, weight > 0.0), []).append(index)

    def _never(self, transition: Transition) -> bool:
        if transition.role in _NEVER:
            return True
        if transition.role is Role.END and all(place.endswith(".cancelling") for place in transition.inputs):
            return True  # what is asked to end early ends as failed
        if transition.guard is not None and transition.guard.name == "cancelled" and not transition.guard.negated:
            self.assumptions["nobody cancels"] = None
            return True
        if self.command is None:
            return False
        return transition.name in self.composition.external and transition.symbol != self.command

    def _start(self, index: int, start: Transition) -> None:
        """Set up the successors of the beginning of an action."""
        if start.timeout is not None:
            self.assumptions["no action is cut short by its time-out"] = None
        name = next(place for place in start.outputs if place.endswith(".active")).removesuffix(".active")
        end, failed = self.transitions[f"{name}.end"], self.transitions[f"{name}.failed"]
        active = f"{name}.active"
        if set(end.inputs) != {active}:
            if start.delay is not None:
                self.assumptions[f"request {name} takes the time of the net that serves it, not its own delay"] = None
            return
        success = start.success if start.success != 1.0 else 1.0 - self.failures
        if not 0.0 <= success <= 1.0:
            raise NetError(f"success {success} of transition {name} is not a probability; 0 to 1 is allowed")
        outcomes = ((self._ways(end, active), success), (self._ways(failed, active), 1.0 - success))
        self._probability.update((way, probability) for ways, probability in outcomes for way in ways)
        if isinstance(start.action, AwaitAction) and start.delay is None and active in self._called_off:
            self.assumptions[f"no message for {name} comes: no 'delay' says when"] = None
            self._timed_ends.update(way for ways, _ in outcomes for way in ways)
        elif start.delay is not None and start.delay.mean > 0.0:
            self._timed_ends.update(way for ways, _ in outcomes for way in ways)
            known = self._timer_named.setdefault(name, len(self.timers))
            self.timer_of[index] = known
            if known == len(self.timers):
                taken = tuple(pair for pair in outcomes if pair[1] > 0.0)
                self.timers.append(TimedActivity(name, start.delay, self.number[active], taken))

    def _ways(self, end: Transition, active: str) -> tuple[int, ...]:
        """Return all ways of an end of an action, one for each possible caller."""
        for_nobody = self.by_name[end.name]
        return (*(way for way in self._endings[end.role, active] if way != for_nobody), for_nobody)

    def _weight(self, transition: Transition) -> float:
        weight = transition.weight
        if transition.strategy is not None:
            successes, failures = transition.strategy.successes, transition.strategy.failures
            if successes + failures > 0.0:
                weight *= successes / (successes + failures)
        if not (weight >= 0.0 and math.isfinite(weight)):
            raise NetError(f"weight {weight} of transition {transition.name} is not a number >= 0")
        return weight
