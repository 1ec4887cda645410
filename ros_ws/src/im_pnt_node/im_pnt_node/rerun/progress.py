"""Incarnation of a node in a re-run: progress of the nets, and the differences."""

from collections.abc import Sequence

from im_pnt.errors import encode_error
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Activity, ActivityState, Lineage
from im_pnt.execution.journal_entries import (
    ActivityEnded,
    EndFired,
    MessageBuilt,
    NetEntry,
    PhaseFired,
    TransitionFired,
)
from im_pnt.model.net import Net
from im_pnt_node.distributed.codec import NET_ENTRY
from im_pnt_node.rerun.difference import Difference, first_difference
from im_pnt_node.rerun.entries import Entries, Input, left_of, shown, transition_of
from im_pnt_node.rerun.stream import NodeStream


class RerunProgress:
    """Recorded entries of the nets of a node, and the repeated ones among the entries.

    Raises:
        NetError: An entry makes no sense.

    Attributes:
        node: Full name of the node.
        turn: The turn of its loop that is run again.
        nets: Its nets, as written.
        executors: The same in execution.
        entries: What was recorded of each.
        gone: Their actions, also those that have ended.
    """

    def __init__(self, stream: NodeStream) -> None:
        self.node, self.turn = stream.node, stream.turns[0]
        self.nets: dict[str, Net] = {}
        self.executors: dict[str, Executor] = {}
        self.entries: dict[str, Entries] = {}
        self.gone: dict[tuple[str, int], Activity] = {}
        for turn in stream.turns:
            for item in turn.items:
                match item:
                    case ["net", str(net), content]:
                        self.entries.setdefault(net, Entries()).recorded.append((NET_ENTRY.decode(content), turn))
                    case ["state", str(net), *_]:
                        self.entries.setdefault(net, Entries())

    def pump(self, executor: Executor) -> bool:
        """Let a net take arrived events up to the first effect, or fire once; return whether there was an effect.

        Of two actions that have ended, the second may have been taken after what the first one let fire, or before.
        """
        entries = self.entries[executor.net.name]
        before = entries.reached
        self._note(executor)
        while entries.reached == before and executor.take():
            pass
        if entries.reached == before:
            executor.pump(1)
        self._note(executor)
        return entries.reached > before

    def _note(self, executor: Executor) -> None:
        for activity in executor.activities:
            self.gone[executor.net.name, activity.number] = activity

    def compare(self, name: str, now: NetEntry) -> None:
        """Compare the present event of a net with the recorded one.

        Raises:
            Difference: It is something else.
        """
        entries = self.entries[name]
        recorded = entries.next()
        if entries.advance(now):
            return
        if recorded is None and isinstance(now, MessageBuilt):
            return  # a message is made after the turn in which its action begins, where the recording may end
        executor = self.executors[name]
        if recorded is None:
            then, why = "nothing more", ""
        elif isinstance(recorded, Input) and not _ends_too(recorded, now):
            then, why = f"goes on with what arrives: {shown(recorded)}", self._earlier(entries, now)
        else:
            then, why = shown(recorded), self._reason(executor, recorded, now)
        transition = transition_of(recorded) or transition_of(now)
        raise self._difference(name, transition, executor, recorded or now, then, shown(now), why)

    def _earlier(self, entries: Entries, now: NetEntry) -> str:
        """Return by how much a firing comes before the recorded one of its transition; empty without one."""
        later = entries.recorded[entries.reached :]
        name = transition_of(now)
        at = next((turn.at for entry, turn in later if name and transition_of(entry) == name), None)
        return "" if at is None else f"in the bag it fires {at - self.turn.at:.3f} s later"

    def missing(self, name: str) -> Difference:
        """Make the difference of a net with no firing in place of a recorded one."""
        entries = self.entries[name]
        recorded = entries.next()
        assert recorded is not None
        executor = self.executors[name]
        why = self._reason(executor, recorded, None)
        transition = transition_of(recorded)
        return self._difference(name, transition, executor, recorded, shown(recorded), "nothing fires", why)

    def late(self, name: str, late: float, tolerance: float) -> Difference:
        """Make the difference of a net whose recorded firing comes later [s] than the tolerance [s] allows."""
        entries, executor = self.entries[name], self.executors[name]
        recorded = entries.next()
        assert recorded is not None
        transition = transition_of(recorded)
        delay = executor.net.transitions[transition].delay
        why = f"its delay is {delay}; the tolerance is {tolerance:g} s"
        return self._difference(name, transition, executor, recorded, shown(recorded), f"fires {late:.3f} s later", why)

    def _difference(
        self, name: str, transition: str, executor: Executor, entry: NetEntry, then: str, now: str, why: str
    ) -> Difference:
        number = entry.number if isinstance(entry, EndFired | ActivityEnded | PhaseFired) else None
        if number is not None and (found := self.gone.get((name, number))) is not None:
            transition, command = transition or found.transition, _command(found.lineage)
        else:
            command = _next_command(executor, transition)
        return Difference(self.node, name, transition, command, self.turn.stamp, then, now, why)

    def differs(self, activity: Activity | None, then: str, now: str, why: str) -> Difference:
        """Make a difference of an action."""
        if activity is None:
            return Difference(self.node, "", "", 0, self.turn.stamp, then, now, why)
        command = _command(activity.lineage)
        return Difference(self.node, activity.net, activity.transition, command, self.turn.stamp, then, now, why)

    def _reason(self, executor: Executor, recorded: NetEntry, now: NetEntry | None) -> str:
        match recorded, now:
            case EndFired(number, name, error, data), EndFired(again, name_now, error_now, data_now) if (
                number == again and name == name_now
            ):
                if told := first_difference(encode_error(error), encode_error(error_now), "failure"):
                    return f"the action ends otherwise: {told}"
                return f"its function leaves something else: {first_difference(left_of(data), left_of(data_now))}"
            case ActivityEnded(number, _, _, data), ActivityEnded(again, _, _, data_now) if number == again:
                return f"its function leaves something else: {first_difference(left_of(data), left_of(data_now))}"
            case EndFired(), _ if now is not None:
                return "the action ends otherwise"
            case MessageBuilt(number, data), _:
                left = left_of(now.data) if isinstance(now, MessageBuilt) and now.number == number else None
                return f"its builder leaves something else: {first_difference(left_of(data), left)}"
        first = f"{now.transition} goes first now" if isinstance(now, TransitionFired) else ""
        return executor.hindrance(transition_of(recorded)) or first

    def drawn(self, name: str, names: Sequence[str]) -> int:
        """Return the recorded choice among several transitions; the first one without a record."""
        entry = self.entries[name].next()
        return names.index(entry.transition) if isinstance(entry, TransitionFired) and entry.transition in names else 0


def _ends_too(recorded: NetEntry, now: NetEntry) -> bool:
    """Return whether the same action ends: kind and answer of the end were compared then."""
    return isinstance(recorded, ActivityEnded) and isinstance(now, ActivityEnded) and recorded.number == now.number


def in_doubt(executor: Executor, number: int) -> bool:
    """Return whether the outcome of an action is unknown."""
    activity = executor.rule.activities.get(number)
    return activity is not None and activity.state is ActivityState.IN_DOUBT


def _command(lineage: Lineage) -> int:
    return lineage.job.command.id if lineage.job is not None else 0


def _next_command(executor: Executor, transition: str) -> int:
    """Return the command of the next firing of a transition."""
    index = executor.rule.number.get(transition)
    if index is None or not executor.rule.enabling.allows(index):
        return 0
    owners = executor.rule.owners(index)
    return owners[0].command.id if owners and owners[0] is not None else 0
