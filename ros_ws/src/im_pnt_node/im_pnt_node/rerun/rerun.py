"""Runs the nets of a recorded mission again, with the same engine, and compares firing by firing.

Each net is driven by what reached it then, in the same order: commands, requests, tokens, ends of actions. What it
fires is a function of that, of its guards and of its functions, which are asked and called again. Choices among
contending transitions that only weights tell apart are those of the recording; time strikes where it did.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from im_core import plugins
from im_core.errors import DataError, ImError
from im_pnt.execution.actions import CheckObjects
from im_pnt.execution.events import ActionEnded, Confirmed, GuardsChanged, ObjectInvalidated
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import Functions
from im_pnt.execution.jobs import Activity, Reply
from im_pnt.execution.journal_entries import ActivityEnded, EndFired, MessageBuilt, PhaseFired
from im_pnt.execution.notification import Nowhere, Observer
from im_pnt.model.action import RequestAction
from im_pnt.model.expand import expand
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt_node.journal.journal import fingerprint
from im_pnt_node.journal.state import restore_net
from im_pnt_node.rerun.difference import Difference, first_difference
from im_pnt_node.rerun.engine import ENDED, ActionsAgain, Labelled, NotDoneAgain, RerunExecutor
from im_pnt_node.rerun.entries import Entries, Input, error_of, reply_difference, told_of, transition_of
from im_pnt_node.rerun.progress import RerunProgress, in_doubt
from im_pnt_node.rerun.script import Messages, Script, ScriptHost
from im_pnt_node.rerun.stream import Item, NodeStream

#: What functions ask of data objects and services, beside what the engine sends for actions.
STORED = ("put", "append", "invalidate", "ask")

#: Time by which a time-out may have struck later than it was due: the loop was busy [s].
SLACK_S = 1.0
#: Time by which a delay may be over later than in the recording, where nothing else is said [s].
TOLERANCE_S = 0.1


@dataclass
class Compared:
    """Summary of a comparison.

    Attributes:
        nets: Names of the nets.
        firings: Their firings.
        inputs: What reached them.
        changed: Nets whose file is not the one of the bag.
    """

    nets: set[str]
    firings: int
    inputs: int
    changed: set[str]


class NodeRerun:
    """The nets of an incarnation of a node, run again.

    Args:
        stream: What was recorded.
        world: How actions are done again.
        messages: Reads and writes messages.
        nets: Nets that take the places of those of the bag, by name.
        tolerance: Time by which a delay may be over later than in the recording [s].

    Raises:
        DataError: What was recorded makes no sense.
        NetError: Likewise.
    """

    def __init__(
        self,
        stream: NodeStream,
        world: ActionsAgain,
        messages: Messages,
        nets: Mapping[str, Net],
        tolerance: float = TOLERANCE_S,
    ) -> None:
        self._stream, self._world, self._given, self._tolerance = stream, world, nets, tolerance
        self._progress = RerunProgress(stream)
        self._script = Script(stream, self._progress.differs, messages)
        self._host = ScriptHost(stream.node, self._script, messages, self._progress.executors, self._progress.nets)
        self._host.values = world.objects(self._host, self._script.spawn, self._guards_changed)
        self._not_again = NotDoneAgain(self._progress)
        self._time = 0.0
        self._before: dict[str, set[int]] = {}
        self._checks: list[tuple[tuple[str, ...], Callable[[ImError | None], None]]] = []
        self._functions: Functions | None = None
        self._compared = Compared(set(), 0, 0, set())

    def run(self) -> Compared:
        """Run the nets.

        Returns:
            What was compared: all was equal.

        Raises:
            Difference: It was not; the first.
            DataError: What was recorded makes no sense.
        """
        try:
            return self._run()
        except (LookupError, TypeError, ValueError, AssertionError) as error:
            text = f"what {self._stream.node} told at {self._progress.turn.stamp:.3f} s cannot be run again: {error!r}"
            raise DataError(text, node=self._stream.node) from error

    def _run(self) -> Compared:
        for number, turn in enumerate(self._stream.turns):
            self._progress.turn = turn
            self._time = max(self._time, turn.at - SLACK_S)
            self._script.step()
            for loaded, items in groupby(enumerate(turn.items), lambda each: each[1][:1] == ["state"]):
                if loaded:
                    self._load([item for _, item in items])
                for rank, item in () if loaded else items:
                    self._script.at = number, rank
                    self._take(item)
            for executor in self._progress.executors.values():
                self._pump_out(executor)
        self._script.step()
        for name, entries in self._progress.entries.items():
            if entries.next() is not None:
                raise self._progress.missing(name)
        if self._all_again and (left := self._script.never_sent(STORED)) is not None:
            what, content = left
            raise self._progress.differs(
                None, f"{what}: {str(content)[:160]}", "nothing of that kind", "another function"
            )
        return self._compared

    def _pump_out(self, executor: Executor) -> None:
        while executor.due and self._progress.pump(executor):
            pass

    @property
    def _all_again(self) -> bool:
        """Whether every action is repeated: none was under way before, and none may move something."""
        return not any(self._before.values()) and not self._not_again.known

    # Nets.

    def _load(self, items: Sequence[Item]) -> None:
        """Take in the nets of consecutive states; for a later recorder, running nets only repeat their states."""
        progress = self._progress
        again = bool(progress.executors) and any(item[:1] == ["node"] for item in progress.turn.items)
        found: list[tuple[Net, Net, dict[str, object]]] = []
        for item in items:
            match item:
                case ["state", str(name), *_] if again and name in progress.executors:
                    continue
                case ["state", str(name), dict(state), str(text)]:
                    recorded = parse_net(text, f"net {name} of the bag")
                    net = self._given.get(name, recorded)
                    if fingerprint(net) != fingerprint(recorded):
                        self._compared.changed.add(name)
                    self._leave(name)
                    progress.nets[name] = net
                    found.append((net, recorded, state))
                case _:
                    raise DataError(f"{str(item)[:100]} is no state of a net")
        told = {net.name for net, _, _ in found}
        for name in [name for name, net in progress.nets.items() if net.former in told and name not in told]:
            del progress.nets[name], progress.executors[name]  # a former version that has ended its commands
        if found:
            self._functions = self._made()
        for net, recorded, state in found:
            self._enter(net, recorded, state)
        self._script.step()

    def _leave(self, name: str) -> None:
        """Finish the turn of a net before another version, or before tokens of another version.

        Raises:
            Difference: It has not fired all that is recorded until then.
        """
        if (executor := self._progress.executors.get(name)) is not None:
            self._pump_out(executor)
            if self._progress.entries[name].reached < self._progress.entries[name].seen:
                raise self._progress.missing(name)

    def _made(self) -> Functions:
        imported = self._not_again.functions(others_made=bool(self._stream.functions))
        if not self._stream.functions:
            return Functions(imported)
        make = plugins.load(self._stream.functions, None, f"what makes the functions of {self._stream.node}")
        assert callable(make)
        made = make(self._host)
        if not isinstance(made, Functions):
            raise DataError(f"{self._stream.functions} makes no functions of nets", functions=self._stream.functions)
        made.actions.update(imported)
        return made

    def _enter(self, net: Net, recorded: Net, state: dict[str, object]) -> None:
        functions, script = self._functions, self._script
        assert functions is not None
        others, asks = self._world.performers(script, functions, self._keep)
        runner = Labelled(script, functions, self, script.spawn, others, asks, lambda: self._time)
        check: CheckObjects = lambda names, done: self._checks.append((names, done))  # noqa: E731
        executor = RerunExecutor(
            net,
            functions,
            runner,
            Nowhere(),
            Observer(),
            check_objects=check,
            clock=lambda: self._time,
            record=lambda entry: self._progress.compare(net.name, entry),
            objects=self._host.values,
            draw=lambda names: self._progress.drawn(net.name, names),
        )
        executor.completions = {}
        fresh = state.get("sequence") == 0 and not state.get("jobs")
        if fresh and (what := first_difference(expand(recorded).initial_marking(), executor.marking())):
            then, _, now = what.rpartition(", now ")
            why = "another initial marking"
            raise Difference(
                self._stream.node, net.name, "", 0, self._progress.turn.stamp, f"begins with {then}", now, why
            )
        restore_net(executor, state)
        self._before[net.name] = set(executor.rule.activities)
        self._progress.executors[net.name] = executor
        self._compared.nets.add(net.name)

    # What was recorded, in its order.

    def _take(self, item: Item) -> None:
        match item:
            case ["net", str(net), _]:
                self._take_entry(net)
            case ["read", list(key), value, error]:
                self._script.resume(key, value, error_of(error))
            case ["heard", str(topic), str(kind), str(data)]:
                self._host.heard[topic] = self._world.heard(kind, data)
                self._wake(f"topic:{topic}")
            case ["object", str(name), bool(valid)]:
                self._wake(f"data:{name}")
                for executor in () if valid else self._progress.executors.values():
                    executor.post(ObjectInvalidated(name))
            case ["node" | "state" | "noted" | "sent", *_]:
                pass
            case _:
                raise DataError(f"{str(item)[:100]} is nothing that a node tells")

    def _wake(self, source: str) -> None:
        for name, executor in self._progress.executors.items():
            if self._functions is not None and source in self._functions.wakes(self._progress.nets[name]):
                executor.post(GuardsChanged(source))

    def _guards_changed(self) -> None:
        for executor in self._progress.executors.values():
            executor.post(GuardsChanged())

    def _take_entry(self, name: str) -> None:
        executor, entries = self._progress.executors.get(name), self._progress.entries[name]
        if executor is None:
            raise DataError(f"net {name} fires in the bag before its state is told", net=name)
        number = entries.seen
        event, _ = entries.recorded[number]
        entries.seen += 1
        self._compared.inputs += isinstance(event, Input)
        self._compared.firings += not isinstance(event, Input | MessageBuilt)
        if entries.reached > number:
            return
        if not isinstance(event, Input):
            self._fire(executor, entries, number)
            return
        if not isinstance(event, ActivityEnded):
            executor.post(event)
        elif executor.due and in_doubt(executor, event.number):
            self._fire(executor, entries, number)
        else:
            self._end(executor, event)

    def _end(self, executor: Executor, event: ActivityEnded) -> None:
        """End an action now, if the end equals the recorded one."""
        assert isinstance(executor, RerunExecutor)
        name, number = executor.net.name, event.number
        activity = executor.rule.activities.get(number) or self._progress.gone.get((name, number))
        if activity is None:
            raise DataError(f"action {number} of net {name} ends in the bag, and did not begin", net=name)
        check = next((each for each in self._checks if each[0] is activity.objects), None)
        if activity.checked and check is not None:
            self._checks.remove(check)
            check[1](event.error)
        begun_before = number in self._before[name]
        if begun_before:
            self._script.forget_unasked()
        recorded = Reply(event.error, event.results)
        now = executor.completions.pop(number, None)
        if now is None:
            waits = self._script.waits_for(activity)
            if begun_before or waits == ENDED:
                self._not_again.leave(activity, event)
            elif waits and not isinstance(activity.action, RequestAction):
                raise self._progress.differs(
                    activity, f"ends {told_of(event.error)}", f"waits for {waits}", "another function"
                )
            now = recorded
        if told := reply_difference(recorded, now):
            raise self._progress.differs(activity, f"ends {told_of(event.error)}", f"ends {told_of(now.error)}", told)
        for kind in ("request", "action"):
            if (left := self._script.left_unsent(kind, activity)) is not None and executor.rule.activities.get(number):
                raise self._progress.differs(activity, f"asks {str(left)[:160]}", "asks nothing", "another request")
        executor.post(ActionEnded(activity, now.error, now.results))

    def _fire(self, executor: Executor, entries: Entries, number: int) -> None:
        """Let a net repeat a recorded firing."""
        while entries.reached <= number:
            if not (self._progress.pump(executor) or self._pump_stuck(executor, entries)):
                raise self._progress.missing(executor.net.name)

    def _pump_stuck(self, executor: Executor, entries: Entries) -> bool:
        """Ask guards again, then let timers strike, then end actions of a former incarnation as recorded."""
        executor.post(GuardsChanged())
        if self._progress.pump(executor) or self._strike(executor, entries):
            return True
        entry = entries.next()
        proposed = transition_of(entry).removesuffix(".start")
        if proposed in executor.proposed:  # that the operator confirmed it is in no journal
            executor.post(Confirmed(proposed))
            return self._progress.pump(executor)
        if isinstance(entry, EndFired | PhaseFired | MessageBuilt) and entry.number in self._before[executor.net.name]:
            executor.replay(entry)
            return entries.advance(entry)
        return False

    def _strike(self, executor: Executor, entries: Entries) -> bool:
        """Let the timer strike that a recorded firing waits for.

        Raises:
            Difference: The delay of the transition is over later than in the recording, by more than the tolerance.
        """
        before, turn = self._time, self._progress.turn
        name = transition_of(entries.next())
        at = executor.strikes_at(name)
        if at is not None and (late := at - before) > self._tolerance:
            raise self._progress.late(executor.net.name, late, self._tolerance)
        if at is None and (at := executor.next_wakeup()) is not None and at > turn.at + SLACK_S:
            return False
        if at is None:
            return False
        self._time = max(before, at)
        struck = self._progress.pump(executor)
        self._time = before
        return struck

    # What the nets send.

    def _keep(self, activity: Activity) -> None:
        """Compare the notes of a builder with the recorded ones."""
        self._progress.executors[activity.net].built(activity)

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Compare a request with the recorded one."""
        self._script.label = activity
        self._script.sent(["request", activity.net, activity.number], [str(activity.action), arguments])

    def awaits_reply(self, activity: Activity) -> bool:
        """Return whether a reply is still to come in the recording."""
        return True
