"""A recording to scroll in: the marking of every net at any moment, out of a bag.

Nodes publish each firing, and of markings that follow each other quickly only the last one. After a recorded marking
the net is as it says; after the firings since then it is as they leave it, in the expanded net. Tokens of other nets
are on no topic: they are seen when the next marking tells of them, or when a firing takes them.
"""

from bisect import bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, NamedTuple

from im_bag.reading import messages_of
from im_core.errors import DataError
from im_pnt.execution.doubt import UNKNOWN
from im_pnt.execution.notification import Firing, Phase
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import expand
from im_pnt.model.net import Net
from im_pnt_analysis.recorded.firings import (
    FIELDS,
    FIRINGS,
    NETS,
    Mission,
    MissionTime,
    mission_from,
    net_told,
    stamp_of,
)

MARKINGS = "/pnt/markings"
_WANTED = {
    FIRINGS: ("im_msgs/msg/Firing",),
    MARKINGS: ("im_msgs/msg/Marking",),
    NETS: ("im_msgs/msg/NetDescription",),
}
_FIELDS = {
    **FIELDS,
    "im_msgs/msg/Marking": ("stamp", "net", "sequence", "places", "tokens", "mode", "paused", "proposed"),
}
#: Every so many moments the whole state is kept, from which that of any other moment is a few firings away.
_KEPT_EVERY = 256
#: How the expanded net calls the transition of each phase behind its name; the first one that tokens enable has fired.
_PHASES: Mapping[int, Sequence[str]] = {
    Phase.START: (".start",),
    Phase.END: ("", ".end", ".end.cancelling", ".end.in_doubt"),
    Phase.FAILED: (".failed", ".failed.cancelling", ".failed.in_doubt"),
    Phase.CANCEL: (".cancel",),
    Phase.DOUBT: (".lost", ".lost.cancelling"),
}


class Description(NamedTuple):
    """Net as described by the node."""

    net: Net
    node: str


class RecordedMarking(NamedTuple):
    """Published marking.

    Attributes:
        net: Its net.
        sequence: Number of the firing after which it holds.
        tokens: Tokens of the marked places of the expanded net.
        mode: How the net is operated.
        paused: Whether it starts nothing new.
        proposed: Transitions that wait to be confirmed.
    """

    net: str
    sequence: int
    tokens: Mapping[str, int]
    mode: str
    paused: bool
    proposed: Sequence[str]


class Described(NamedTuple):
    """Description or removal of a net.

    Attributes:
        net: Its name.
        description: Number of its description among those of the recording; None: it was unloaded.
    """

    net: str
    description: int | None


class Moment(NamedTuple):
    """Event of a recording.

    Attributes:
        at_s: Testbed time since the first firing; it never falls [s].
        event: What.
    """

    at_s: float
    event: Firing | RecordedMarking | Described


@dataclass(frozen=True, slots=True)
class NetState:
    """A net at a moment.

    Attributes:
        description: Number of its description; None: it is never described, or has gone.
        marking: As it was recorded, or as firings have left it since.
        fired: Number of the firing that was heard last.
        marked: That of the marking that was heard last.
    """

    description: int | None
    marking: RecordedMarking
    fired: int
    marked: int


class NetRecording:
    """The nets of a bag, moment by moment."""

    def __init__(self, descriptions: Sequence[Description], moments: Sequence[Moment], mission: Mission) -> None:
        self.descriptions, self.mission = descriptions, mission
        first = next(rank for rank, moment in enumerate(moments) if isinstance(moment.event, Firing))
        self.moments = moments[first:]
        self._first: dict[str, int] = {}
        for rank, description in enumerate(descriptions):
            self._first.setdefault(description.net.name, rank)
        self._rules = [_Rule(description.net) for description in descriptions]
        self._times = [moment.at_s for moment in self.moments]
        self._firings = [rank for rank, moment in enumerate(self.moments) if isinstance(moment.event, Firing)]
        states: dict[str, NetState] = {}
        for moment in moments[:first]:
            self.advance(states, moment)
        self._kept = [dict(states)]
        for rank, moment in enumerate(self.moments, 1):
            self.advance(states, moment)
            if rank % _KEPT_EVERY == 0:
                self._kept.append(dict(states))

    @property
    def firings(self) -> int:
        """Number of firings."""
        return len(self._firings)

    def position_at(self, at_s: float) -> int:
        """Return the number of moments up to a time, inclusive.

        Args:
            at_s: Time since the first firing [s].
        """
        return bisect_right(self._times, at_s)

    def position_of(self, firing: int) -> int:
        """How many moments have passed when a firing has just happened.

        Args:
            firing: Its number, from 1 to :attr:`firings`; 0: before the first.

        Raises:
            DataError: There is no such firing.
        """
        if not 0 <= firing <= self.firings:
            raise DataError(f"there is no firing {firing}: the recording has {self.firings}", firing=firing)
        return self._firings[firing - 1] + 1 if firing else 0

    def firings_until(self, position: int) -> int:
        """How many of the first moments are firings."""
        return bisect_right(self._firings, position - 1)

    def firings_before(self, position: int, count: int) -> Iterator[tuple[float, Firing]]:
        """Return the last firings before a position with the times [s], in order."""
        until = self.firings_until(position)
        for rank in self._firings[max(0, until - count) : until]:
            moment = self.moments[rank]
            assert isinstance(moment.event, Firing)
            yield moment.at_s, moment.event

    def states(self, position: int) -> dict[str, NetState]:
        """The nets after the first moments.

        Args:
            position: How many, 0 to the number of :attr:`moments`.
        """
        kept = position // _KEPT_EVERY
        states = dict(self._kept[kept])
        for moment in self.moments[kept * _KEPT_EVERY : position]:
            self.advance(states, moment)
        return states

    def advance(self, states: dict[str, NetState], moment: Moment) -> None:
        """Apply a moment to the states of the nets.

        Of one life of a net each topic comes in its order, but one may be behind the other: a marking that firings have
        overtaken is passed over, as is a firing after which a marking was heard already.
        """
        event = moment.event
        state = states.get(event.net) or self._begun(event.net)
        if isinstance(event, Described):
            states[event.net] = replace(state, description=event.description)
            return
        if isinstance(event, RecordedMarking):
            if event.sequence < state.marked:  # the net has begun anew, or came back from its journal
                state = NetState(state.description, event, event.sequence, event.sequence)
            elif event.sequence >= state.marking.sequence:
                state = replace(state, marking=event, marked=event.sequence)
        else:
            if event.sequence <= state.fired:
                state = self._begun(event.net, state.description)
            marking = state.marking
            if event.sequence > marking.sequence:
                marking = marking._replace(sequence=event.sequence, tokens=self._fired(state, event))
            state = replace(state, marking=marking, fired=event.sequence)
        states[event.net] = state

    def _begun(self, net: str, description: int | None = None) -> NetState:
        """Return the state of a net with a description only."""
        number = self._first.get(net) if description is None else description
        tokens = {} if number is None else self._rules[number].initial
        return NetState(number, RecordedMarking(net, 0, tokens, "automatic", False, ()), 0, 0)

    def _fired(self, state: NetState, firing: Firing) -> Mapping[str, int]:
        tokens = state.marking.tokens
        return tokens if state.description is None else self._rules[state.description].fired(tokens, firing)


class _Rule:
    """Effect of firings on the marking of a net.

    Attributes:
        initial: Tokens of the marked places at the beginning.
    """

    def __init__(self, net: Net) -> None:
        self._compiled = compile_net(expand(net))
        self._numbers = {name: number for number, name in enumerate(self._compiled.transitions)}
        self.initial = self._compiled.net.initial_marking()

    def fired(self, tokens: Mapping[str, int], firing: Firing) -> Mapping[str, int]:
        """Return the tokens after a firing; missing ones came from another net."""
        compiled = self._compiled
        endings = _PHASES.get(firing.phase, ())
        if firing.phase == Phase.FAILED and firing.message.startswith(UNKNOWN):
            endings = (".given_up", *endings)
        names = (f"{firing.transition}{ending}" for ending in endings)
        found = [self._numbers[name] for name in names if name in self._numbers]
        if not found:
            return tokens
        vector = tuple(tokens.get(place, 0) for place in compiled.places)
        taken = next((number for number in found if compiled.enabled(vector, number)), found[0])
        return compiled.marking(tuple(max(0, count) for count in compiled.fire(vector, taken)))


def recording_of(bag: Path) -> NetRecording:
    """The nets of a bag.

    Args:
        bag: Folder of the bag, or a file of it.

    Raises:
        DataError: It cannot be read, holds no firings, markings or descriptions of nets, or nothing has fired in it.
    """
    descriptions: list[Description] = []
    numbers: dict[tuple[str, str, str], int] = {}
    firings: list[Any] = []
    moments: list[Moment] = []
    time: MissionTime | None = None
    at_s = 0.0
    for message in messages_of(bag, _WANTED, _FIELDS):
        told = message.content
        if message.topic == FIRINGS:
            firings.append(told)
            time = time or MissionTime(told)
            at_s = max(at_s, time.of(told))
            moments.append(Moment(at_s, _firing(bag, told)))
        elif message.topic == MARKINGS:
            if time is not None:
                at_s = max(at_s, stamp_of(told) - time.zero_s)
            moments.append(Moment(at_s, _marking(told)))
        elif not told.json:
            moments.append(Moment(at_s, Described(told.net, None)))
        else:
            number = numbers.setdefault((told.net, told.node, told.json), len(descriptions))
            if number == len(descriptions):
                descriptions.append(Description(net_told(bag, told), told.node))
            moments.append(Moment(at_s, Described(told.net, number)))
    if not firings:
        raise DataError(f"{bag}: nothing has fired in it", file=str(bag))
    nets = {description.net.name: description.net for description in descriptions}
    return NetRecording(descriptions, moments, mission_from(firings, nets))


def _firing(bag: Path, told: Any) -> Firing:
    if not (isfinite(told.duration) and isfinite(told.progress)):
        text = f"a firing of net {told.net} with duration {told.duration} and progress {told.progress}"
        raise DataError(f"{bag}: there is {text} in it", file=str(bag))
    return Firing(
        told.net,
        told.transition,
        int(told.sequence),
        told.phase,
        told.symbol,
        int(told.command_id),
        told.message,
        float(told.duration),
        float(told.progress),
    )


def _marking(told: Any) -> RecordedMarking:
    tokens = {place: int(count) for place, count in zip(told.places, told.tokens, strict=False)}
    return RecordedMarking(told.net, int(told.sequence), tokens, told.mode, bool(told.paused), tuple(told.proposed))
