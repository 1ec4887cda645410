"""Firings of a mission in a bag: the times, causes and durations, beside the expected ones."""

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean, median
from typing import Any

from im_bag.reading import messages_of, open_bag, read_on
from im_core.errors import DataError, ImError
from im_pnt.description import read_net
from im_pnt.execution.notification import Firing
from im_pnt.model.net import Net

FIRINGS, NETS = "/pnt/firings", "/pnt/nets"
#: What is read of their messages.
FIELDS = {
    "im_msgs/msg/Firing": ("stamp", *Firing._fields),
    "im_msgs/msg/NetDescription": ("net", "node", "json"),
}
_START, _END, _FAILED, _CANCEL = 0, 1, 2, 3


@dataclass(frozen=True)
class Topic:
    """Content of a topic in a bag.

    Attributes:
        name: Its name.
        type: Type of its messages.
        count: Number of messages.
        silence_s: Longest time between two messages [s].
    """

    name: str
    type: str
    count: int
    silence_s: float


@dataclass(frozen=True)
class RecordedFiring:
    """Firing, from the start of the action to the end.

    Attributes:
        net: Its net.
        transition: Its transition.
        command_id: Command that it served; 0: none.
        begin_s: Testbed time of the start, from the first firing of the bag [s].
        end_s: Testbed time of the end; None: the bag does not hold it [s].
        failed: Whether it failed.
        begun: Whether the bag holds its start; else it began before, and ``begin_s`` is its end.
        cancelled: Whether its action was asked to end early.
        after: Transition of its net whose token it took last, and so waited for; empty: none in the bag.
    """

    net: str
    transition: str
    command_id: int
    begin_s: float
    end_s: float | None
    failed: bool
    begun: bool
    cancelled: bool
    after: str

    @property
    def on_time_line(self) -> bool:
        """Whether the time line shows the firing: one with a duration, without an end, or failed."""
        return self.failed or self.end_s is None or self.end_s > self.begin_s


@dataclass(frozen=True)
class ActionTimes:
    """Statistics of one action.

    Attributes:
        net: Its net.
        transition: Its transition.
        count: How often it ended.
        failures: How often it failed, of these.
        mean_s: Mean duration [s].
        median_s: Median duration [s].
        longest_s: Longest duration [s].
        expected_s: Mean of the delay in its net; None: the net says none [s].
    """

    net: str
    transition: str
    count: int
    failures: int
    mean_s: float
    median_s: float
    longest_s: float
    expected_s: float | None


@dataclass(frozen=True)
class Mission:
    """Statements of a bag on the nets.

    Attributes:
        firings: In the order of their starts.
        gaps: Nets whose events were not all recorded: from which number to which.
        nets: As they were when they were last described.
    """

    firings: Sequence[RecordedFiring]
    gaps: Sequence[tuple[str, int, int]]
    nets: Mapping[str, Net]

    def actions(self) -> list[ActionTimes]:
        """Return statistics of the transitions with an action, the longest total first."""
        taken: dict[tuple[str, str], list[RecordedFiring]] = {}
        for firing in self.firings:
            if firing.end_s is not None and firing.begun and self._acts(firing):
                taken.setdefault((firing.net, firing.transition), []).append(firing)
        told = [self._times(*name, firings) for name, firings in taken.items()]
        return sorted(told, key=lambda times: -times.count * times.mean_s)

    def _acts(self, firing: RecordedFiring) -> bool:
        transition = self._transition(firing.net, firing.transition)
        return transition.action is not None if transition else firing.end_s != firing.begin_s

    def _transition(self, net: str, transition: str) -> Any:
        return self.nets[net].transitions.get(transition) if net in self.nets else None

    def _times(self, net: str, transition: str, firings: Sequence[RecordedFiring]) -> ActionTimes:
        durations = [firing.end_s - firing.begin_s for firing in firings if firing.end_s is not None]
        written = self._transition(net, transition)
        return ActionTimes(
            net=net,
            transition=transition,
            count=len(durations),
            failures=sum(firing.failed for firing in firings),
            mean_s=fmean(durations),
            median_s=median(durations),
            longest_s=max(durations),
            expected_s=written.delay.mean if written and written.delay else None,
        )


def contents_of(bag: Path) -> list[Topic]:
    """The topics of a bag, by name.

    Raises:
        DataError: It cannot be read.
    """
    last: dict[str, int] = {}
    silences: dict[str, int] = {}
    counts: dict[str, int] = {}
    with closing(open_bag(bag)) as reader:
        types = {connection.topic: connection.msgtype for connection in reader.connections}
        for connection, logged_ns, _ in read_on(bag, reader.messages()):
            topic = connection.topic
            silences[topic] = max(silences.get(topic, 0), logged_ns - last.get(topic, logged_ns))
            last[topic], counts[topic] = logged_ns, counts.get(topic, 0) + 1
    return [Topic(name, types[name], counts.get(name, 0), silences.get(name, 0) * 1e-9) for name in sorted(types)]


def mission_of(bag: Path) -> Mission:
    """The firings of a bag.

    Raises:
        DataError: It cannot be read, or holds no firings.
    """
    wanted = {FIRINGS: ("im_msgs/msg/Firing",)}
    with closing(open_bag(bag)) as reader:
        described = any(connection.topic == NETS for connection in reader.connections)
    if described:
        wanted[NETS] = ("im_msgs/msg/NetDescription",)
    nets: dict[str, Net] = {}
    events = []
    for message in messages_of(bag, wanted, FIELDS):
        if message.topic == FIRINGS:
            events.append(message.content)
        elif message.content.json:  # else the net has gone
            nets[message.content.net] = net_told(bag, message.content)
    if not events:
        raise DataError(f"{bag}: nothing has fired in it", file=str(bag))
    return mission_from(events, nets)


def mission_from(events: Sequence[Any], nets: Mapping[str, Net]) -> Mission:
    """Return the mission of some firings.

    Args:
        events: Messages of ``/pnt/firings`` in the order in which they came, at least one.
        nets: As they were when they were last described.
    """
    return Mission(_firings(events, nets), _gaps(events), nets)


class MissionTime:
    """Testbed time since the first firing; after a restart of the testbed, time goes on from the last value.

    Attributes:
        zero_s: Testbed time from which it counts, as of the life of the testbed that was heard last [s].
    """

    def __init__(self, first: Any) -> None:
        self.zero_s = self._latest_s = stamp_of(first)
        self._of_net: dict[str, float] = {}

    def of(self, firing: Any) -> float:
        """Return the time of a firing, the next one in the order of arrival [s].

        Those of one net come in their order, so that a time which falls there is another testbed's. One without a stamp
        is of a node that has not heard of the time: it is of the time of those before it.
        """
        stamp_s = stamp_of(firing)
        if stamp_s == 0.0:
            return self._latest_s - self.zero_s
        if stamp_s < self._of_net.get(firing.net, stamp_s):
            self.zero_s += stamp_s - self._latest_s
            self._latest_s = stamp_s
            self._of_net.clear()
        self._of_net[firing.net] = stamp_s
        self._latest_s = max(self._latest_s, stamp_s)
        return stamp_s - self.zero_s


def net_told(bag: Path, told: Any) -> Net:
    """Return the net in a message of ``/pnt/nets``.

    Raises:
        DataError: It describes none.
    """
    try:
        return read_net(told.net, told.json, told.node)
    except ImError as error:
        raise DataError(f"{bag}: the description of net {told.net} cannot be read: {error.message}") from error


def _firings(events: Sequence[Any], nets: Mapping[str, Net]) -> list[RecordedFiring]:
    """Join starts and ends: the ends of a transition come in the order of the starts, command by command.

    What ran in a net that begins anew, and counts its events from 1 again, has not ended.
    """
    time = MissionTime(events[0])
    found: list[dict[str, Any]] = []
    running: dict[str, dict[tuple[str, int], list[dict[str, Any]]]] = {}
    ended: dict[str, list[str]] = {}
    last: dict[str, int] = {}
    for event in events:
        moment_s = time.of(event)
        if event.sequence <= last.get(event.net, 0):
            running.pop(event.net, None)
        last[event.net] = event.sequence
        begun = running.setdefault(event.net, {}).setdefault((event.transition, event.command_id), [])
        if event.phase == _CANCEL and begun:
            begun[0]["cancelled"] = True
        if event.phase not in (_START, _END, _FAILED):
            continue
        if event.phase == _START or not begun:  # an end alone: it takes no time, or the recording began later
            firing = {
                "net": event.net,
                "transition": event.transition,
                "command_id": event.command_id,
                "begin_s": moment_s,
                "end_s": None,
                "failed": False,
                "begun": event.phase == _START or not event.duration,  # one that takes no time has no start
                "cancelled": False,
                "after": _giver(event, nets, ended.get(event.net, [])),
            }
            found.append(firing)
            begun.append(firing)
        if event.phase != _START:
            begun.pop(0).update(end_s=moment_s, failed=event.phase == _FAILED)
            ended.setdefault(event.net, []).append(event.transition)
    return [RecordedFiring(**firing) for firing in found]


def _giver(event: Any, nets: Mapping[str, Net], ended: Sequence[str]) -> str:
    """Return the last ended transition among the sources of a firing's tokens."""
    transitions = nets[event.net].transitions if event.net in nets else {}
    if event.transition not in transitions:
        return ""
    takes = set(transitions[event.transition].inputs)
    return next((name for name in reversed(ended) if name in transitions and takes & _gives(transitions[name])), "")


def _gives(transition: Any) -> set[str]:
    return {*transition.outputs, *transition.on_failure}


def _gaps(events: Sequence[Any]) -> list[tuple[str, int, int]]:
    """Return first and last number of missing events between two of a net; a restarted net counts from 1."""
    last: dict[str, int] = {}
    gaps = []
    for event in events:
        before = last.get(event.net, event.sequence - 1)
        if event.sequence > before + 1:
            gaps.append((event.net, before + 1, event.sequence - 1))
        last[event.net] = event.sequence
    return gaps


def stamp_of(message: Any) -> float:
    """The stamp of a message, testbed time [s]."""
    return float(message.stamp.sec) + float(message.stamp.nanosec) * 1e-9
