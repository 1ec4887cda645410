"""Incarnation of a node in a re-run: progress of the nets, and the differences."""

from collections.abc import Sequence

from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Activity, ActivityState, Lineage
from im_pnt.execution.journal_entries import NetEntry
from im_pnt.model.net import Net
from im_pnt_node.journal.codec import encode_net_entry
from im_pnt_node.rerun.difference import Difference, first_difference
from im_pnt_node.rerun.entries import INPUTS, Entries, left_of, plain, shown, transition_of
from im_pnt_node.rerun.stream import NodeStream


class Life:
    """Recorded entries of the nets of a node, and the repeated ones among the entries.

    Args:
        stream: What was recorded.

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
                    case ["net", str(net), list(content)]:
                        self.entries.setdefault(net, Entries()).recorded.append((content, turn))
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

    def compare(self, name: str, entry: NetEntry) -> None:
        """Compare the present event of a net with the recorded one.

        Raises:
            Difference: It is something else.
        """
        entries, now = self.entries[name], plain(encode_net_entry(entry))
        recorded = entries.next()
        if entries.advance(now):
            return
        if recorded is None and now[0] == "built":
            return  # a message is made after the turn in which its action begins, where the recording may end
        executor = self.executors[name]
        if recorded is None:
            then, why = "nothing more", ""
        elif recorded[0] in INPUTS and not _ends_too(recorded, now):
            then, why = f"goes on with what arrives: {shown(recorded)}", ""
        else:
            then, why = shown(recorded), self._reason(executor, recorded, now)
        transition = transition_of(recorded or now) or transition_of(now)
        raise self._difference(name, transition, executor, recorded or now, then, shown(now), why)

    def missing(self, name: str) -> Difference:
        """Make the difference of a net with no firing in place of a recorded one."""
        entries = self.entries[name]
        recorded = entries.next()
        assert recorded is not None
        executor = self.executors[name]
        why = self._reason(executor, recorded, None)
        transition = transition_of(recorded)
        return self._difference(name, transition, executor, recorded, shown(recorded), "nothing fires", why)

    def _difference(
        self, name: str, transition: str, executor: Executor, content: Sequence[object], then: str, now: str, why: str
    ) -> Difference:
        command = 0
        match content:
            case ["end" | "ended" | "phase", int(number), *_] if (found := self.gone.get((name, number))) is not None:
                transition, command = transition or found.transition, _command(found.lineage)
            case _:
                command = _next_command(executor, transition)
        return Difference(self.node, name, transition, command, self.turn.stamp, then, now, why)

    def differs(self, activity: Activity | None, then: str, now: str, why: str) -> Difference:
        """Make a difference of an action."""
        if activity is None:
            return Difference(self.node, "", "", 0, self.turn.stamp, then, now, why)
        command = _command(activity.lineage)
        return Difference(self.node, activity.net, activity.transition, command, self.turn.stamp, then, now, why)

    def _reason(self, executor: Executor, recorded: list[object], now: list[object] | None) -> str:
        if now is not None and recorded[:3] == now[:3] and recorded[0] == "end":
            if recorded[3] != now[3]:
                return f"the action ends otherwise: {first_difference(recorded[3], now[3], 'failure')}"
            return f"its function leaves something else: {first_difference(left_of(recorded[4]), left_of(now[4]))}"
        if now is not None and _ends_too(recorded, now):
            then, again = (left_of(each[4]) if len(each) > 4 else None for each in (recorded, now))
            return f"its function leaves something else: {first_difference(then, again)}"
        if now is not None and recorded[0] == "end":
            return "the action ends otherwise"
        if recorded[0] == "built":
            left = left_of(now[2]) if now is not None and now[:2] == recorded[:2] else None
            return f"its builder leaves something else: {first_difference(left_of(recorded[2]), left)}"
        first = f"{transition_of(now)} goes first now" if now is not None and now[0] == "fire" else ""
        return executor.hindrance(transition_of(recorded)) or first

    def drawn(self, name: str, names: Sequence[str]) -> int:
        """Return the recorded choice among several transitions; the first one without a record."""
        match self.entries[name].next():
            case ["fire", str(taken), *_] if taken in names:
                return names.index(taken)
        return 0


def _ends_too(recorded: list[object], now: list[object]) -> bool:
    """Return whether the same action ends: kind and answer of the end were compared then."""
    return recorded[0] == now[0] == "ended" and recorded[1] == now[1]


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
