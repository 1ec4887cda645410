"""Run of a scenario: the engine of the nodes, in virtual time, with mocked actions."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Coroutine, Mapping, Sequence
from functools import partial

from im_core.errors import ImError
from im_pnt.execution.events import CommandCancelled, RequestArrived, RequestCancelled
from im_pnt.execution.executor import Executor
from im_pnt.execution.firing.rule import DOUBT_CODE
from im_pnt.execution.functions import ActionContext, Functions, GuardFunction
from im_pnt.execution.jobs import Activity, ActivityState, Command, CommandResult, Request
from im_pnt.execution.notification import Firing, Observer, Phase
from im_pnt.execution.runner import FunctionRunner, Perform
from im_pnt.execution.timers import Timers
from im_pnt.model.action import (
    AwaitAction,
    FunctionAction,
    GoalAction,
    RequestAction,
    ServiceAction,
    TopicAction,
)
from im_pnt.model.net import OTHERWISE, Guard, Net, Transition
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.scenario.draws import Draws, ValueDraw
from im_pnt_node.scenario.file import AnswerFile, Scenario, ScenarioSet, StepFile, split_name
from im_pnt_node.scenario.mocks import SCOPE, AwaitedMessage, MockedObjects, Pause, completed
from im_pnt_node.scenario.report import Coverage, ScenarioOrder, ScenarioReport

MOST_FIRINGS = 20_000
"""After which a run is taken for endless."""

_MARKS = {Phase.START: "+", Phase.END: "", Phase.FAILED: "!", Phase.CANCEL: "~", Phase.DOUBT: "?"}
_MESSAGES = (ServiceAction, GoalAction, TopicAction, AwaitAction)
_ANSWERED = (ServiceAction, GoalAction, AwaitAction)
_TYPES = {ServiceAction: "_Response", GoalAction: "_Result", AwaitAction: ""}
_CANCELLED = "the scenario cancels it"
_BY_ITSELF = AnswerFile()


class ScenarioRunner(Observer):
    """One run of a scenario.

    Args:
        scenarios: The file.
        scenario: The scenario.
        values: Draws fields of answers that are not written.
        coverage: Takes what is reached.
        draws: What decides what is drawn; None: nothing is, and every action without an answer ends well.
    """

    def __init__(
        self,
        scenarios: ScenarioSet,
        scenario: Scenario,
        values: ValueDraw,
        coverage: Coverage,
        draws: Draws | None = None,
    ) -> None:
        self._nets, self._all = {net.name: net for net in scenarios.nets}, scenarios.nets
        self._file, self._coverage, self._draws, self._values = scenario.content, coverage, draws, values
        self._now, self._timers, self._used = 0.0, Timers(), Counter[str]()
        self._guards = dict(self._file.guards)
        self._paused: set[Coroutine[object, object, None]] = set()
        self._asked: dict[tuple[str, str], tuple[int, bool]] = {}
        self._objects = MockedObjects(self._file.objects)
        self._waiting: dict[tuple[str, str], list[tuple[int, StepFile]]] = defaultdict(list)
        topics = (topic for step in self._file.steps for topic in step.messages)
        self._listening: dict[str, list[AwaitedMessage]] = {topic: [] for topic in topics}
        self._latest: dict[str, Mapping[str, object]] = {}
        self._heard_at: dict[str, float] = {}
        self._watches = {(net.name, t.cancels) for net in scenarios.nets for t in net.transitions.values() if t.cancels}
        self._outcome = ScenarioReport()
        self._exchange = _ScenarioExchange(self)
        functions = _WatchedFunctions(self, scenarios.nets)
        others: dict[type, Perform] = dict.fromkeys(_MESSAGES, self._perform)
        runner = FunctionRunner(functions, self._exchange, self._go_on, others, clock=self._clock)
        for net in scenarios.nets:
            executor = Executor(
                net,
                functions,
                runner,
                self._exchange,
                self,
                clock=self._clock,
                objects=self._objects,
                draw=None if draws is None else lambda names: draws.pick(len(names)),
            )
            self._exchange.add(executor)

    def run(self) -> ScenarioReport:
        """Run until the end of the scenario."""
        for number, step in enumerate(self._file.steps, 1):
            if step.during is None:
                self._timers.at(step.at, partial(self._act, number, step))
            else:
                self._outcome.not_begun.append(number)
                net, name = split_name(step.during, self._all)
                net = net or next(each.name for each in self._all if name in each.transitions)
                self._waiting[net, name].append((number, step))
        executors = list(self._exchange.nets.values())
        while not self._outcome.endless:
            self._pump(executors)
            times = [self._timers.next(), *(executor.next_wakeup() for executor in executors)]
            due = min((time for time in times if time is not None), default=math.inf)
            over = self._timers.next() is None and not any(executor.busy() for executor in executors)
            if due > (math.inf if self._file.until is None else self._file.until) or math.isinf(due):
                break
            if over and self._file.until is None:
                break
            self._now = max(self._now, due)
            self._timers.strike(self._now)
        self._now = self._now if self._file.until is None else max(self._now, self._file.until)
        out = self._outcome
        out.time = self._now
        out.marking = {name: executor.marking() for name, executor in self._exchange.nets.items()}
        out.unrest = [f"net {executor.net.name}: {rest}" for executor in executors if not (rest := executor.at_rest())]
        for work in self._paused:
            work.close()
        return out

    def _pump(self, executors: Sequence[Executor]) -> None:
        while sum(executor.pump() for executor in executors) or any(executor.due for executor in executors):
            if len(self._outcome.firings) > MOST_FIRINGS:
                self._outcome.endless = True
                return

    def _clock(self) -> float:
        return self._now

    # What the nets tell.

    def fired(self, firings: Sequence[Firing]) -> None:
        """Keep firings, and take the steps in wait of one."""
        for firing in firings:
            net, name = firing.net, firing.transition
            self._outcome.firings.append((self._now, net, name + _MARKS[firing.phase]))
            self._coverage.transitions[net].add(name)
            if firing.phase is Phase.START:
                for number, step in self._waiting.pop((net, name), ()):
                    self._outcome.not_begun.remove(number)
                    self._timers.at(self._now + step.at, partial(self._act, number, step))

    def troubled(self, net: str, text: str) -> None:
        """Keep a complaint."""
        self._outcome.troubles.append(f"{net}: {text}" if net else text)

    # Steps.

    def _act(self, number: int, step: StepFile) -> None:
        if step.symbol is not None or step.request is not None:
            self._write(number, step)
        elif step.cancel is not None:
            net, name = split_name(step.cancel, self._all)
            orders = self._outcome.orders.values()
            for order in [each for each in orders if each.name == name and net in ("", each.net)][-1:]:
                self._cancel(order)
        elif step.messages:
            for topic, message in step.messages.items():
                self._latest[topic], self._heard_at[topic] = message, self._now
                for hearing in tuple(self._listening[topic]):
                    hearing.hear(message)
        else:
            self._guards |= step.guards
            self._asked = {key: each for key, each in self._asked.items() if key[1] not in step.guards}
            for name in step.guards:
                self._used.pop(name, None)
            self._objects.give(step.objects)
            for executor in self._exchange.nets.values():
                executor.guards_changed()

    def _write(self, number: int, step: StepFile) -> None:
        asked = step.symbol or step.request or ""
        net, name = split_name(asked, self._all)
        net = net or next(each.name for each in self._all if name in (*each.symbols(), *each.services))
        executor = self._exchange.nets[net]
        schema, arguments = self._nets[net].arguments_of(name), dict(step.arguments)
        if schema is not None:
            if self._draws is not None:
                missing = (each for each in schema.arguments.values() if each.name not in arguments)
                arguments |= {each.name: self._values.argument(each, self._draws) for each in missing}
            arguments = schema.check(arguments, asked)
        order = ScenarioOrder(number, net, name, step.request is not None, self._now, arguments)
        self._outcome.orders[number] = order
        key = "symbol" if step.symbol is not None else "request"
        self._outcome.script.steps.append({"at": self._now, key: asked, "arguments": arguments})
        command = Command(number, name if step.symbol else "", arguments, scope=f"{SCOPE}{number}")
        if step.symbol is not None:
            order.job = executor.command(command, partial(self.end, order))
        else:
            request = Request(f"{SCOPE}{number}", net, name, "", "", "", command, arguments)
            executor.post(RequestArrived(request))

    def end(self, order: ScenarioOrder, result: CommandResult) -> None:
        """Note the end of a command or request."""
        order.ended, order.result = self._now, result

    def replied(self, request: Request, error: ImError | None, results: dict[str, object]) -> bool:
        """Take a reply to a request of the scenario; return whether it was one."""
        if request.caller_net:
            return False
        order = self._outcome.orders[int(request.id.removeprefix(SCOPE))]
        self.end(order, CommandResult(error is None, error, results))
        return True

    def _cancel(self, order: ScenarioOrder) -> None:
        error = ImError(_CANCELLED, code="cancelled")
        for executor in self._exchange.nets.values():
            executor.post(CommandCancelled(order.number, error))
        if order.is_request:
            self._exchange.nets[order.net].post(RequestCancelled(f"{SCOPE}{order.number}", error))

    # Actions.

    def mock(self, name: str) -> Callable[[ActionContext], Coroutine[object, object, None]]:
        """Return the function in the place of an action function."""

        async def function(context: ActionContext) -> None:
            context.result.update(await self._answered(context.net, context.transition, context, {}))

        function.__name__ = name
        return function

    async def _perform(self, activity: Activity, context: ActionContext) -> dict[str, object]:
        fields = await context.filled(getattr(activity.action, "fields", {}))
        assert isinstance(fields, dict)
        return await self._answered(activity.net, activity.transition, context, fields)

    def request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Answer a request to a net that is not there."""

        async def reply() -> None:
            owner = self._exchange.nets[activity.net]
            context = ActionContext(
                activity.net, activity.transition, activity.lineage, activity, values=owner.rule.values
            )
            try:
                owner.ended(activity, None, await self._answered(activity.net, activity.transition, context, arguments))
            except ImError as error:
                owner.ended(activity, error)

        self._go_on(reply())

    async def _answered(
        self, net: str, name: str, context: ActionContext, fields: Mapping[str, object]
    ) -> dict[str, object]:
        """Wait as long as an action takes, and return the fields of the answer that the net reads.

        Raises:
            ImError: It fails, is cancelled, or is in doubt.
        """
        transition = self._nets[net].transitions[name]
        action, key = transition.action, f"{net}.{transition.retry_of or name}"
        if isinstance(action, AwaitAction) and self._written(key) is None:
            unheard = self._draws is None and (net, name) in self._watches
            if action.name in self._listening or unheard:
                return await self._heard(action, context, self._fields_read(transition, context, Draws()))
        answer = self._answer(key, transition, fields, context)
        mean = 0.0 if transition.delay is None else transition.delay.mean
        pause = Pause()
        after = math.inf if answer.silent else mean if answer.after is None else answer.after
        if not answer.silent:
            self._timers.at(self._now + after, pause.wake)
        if isinstance(action, AwaitAction) or (not answer.silent and not isinstance(action, ServiceAction)):
            context.on_cancel(pause.wake)
        began = self._now
        await pause
        if context.cancelled and self._now < began + after:
            raise ImError(f"{action} was cancelled", code="cancelled")
        if answer.doubt is not None:
            why = ImError(answer.doubt, code=DOUBT_CODE)
            self._doubt(self._exchange.nets[net], name, context.command, why)
            raise why
        if answer.answer.get("success") is False:  # in ROS that is a failure, too
            raise ImError(str(answer.answer.get("message") or f"{action} did not succeed"), code=answer.code)
        if answer.failure is not None:
            raise ImError(answer.failure, code=answer.code)
        empty = self._fields_read(transition, context, Draws())
        if isinstance(action, ServiceAction | GoalAction) and empty.get("success") is False:
            empty["success"] = True  # it has ended well
        return completed(empty, answer.answer)

    async def _heard(
        self, action: AwaitAction, context: ActionContext, empty: Mapping[str, object]
    ) -> dict[str, object]:
        """Wait for a message of the scenario that counts, and return its fields.

        Raises:
            ImError: The condition has no value, or the wait is cancelled.
        """
        hearing = AwaitedMessage(action, context, empty)
        context.on_cancel(hearing.pause.wake)
        listening = self._listening.setdefault(action.name, [])
        listening.append(hearing)
        if action.latched and action.name in self._latest:
            hearing.hear(self._latest[action.name])
        if action.silent is not None:
            self._listen_for_silence(hearing, action, self._now, action.silent)
        await hearing.pause
        self._timers.cancel(hearing.timer)
        listening.remove(hearing)
        if hearing.error is not None:
            raise hearing.error
        if hearing.fields is None:
            raise ImError(f"{action} was cancelled", code="cancelled")
        return hearing.fields

    def _listen_for_silence(self, hearing: AwaitedMessage, action: AwaitAction, began: float, longest: float) -> None:
        """Have a wait fail once its topic has been silent for too long."""
        due = max(began, self._heard_at.get(action.name, began)) + longest
        if self._now < due:
            hearing.timer = self._timers.at(due, partial(self._listen_for_silence, hearing, action, began, longest))
        else:
            hearing.error = action.silence
            hearing.pause.wake()

    def _doubt(self, executor: Executor, name: str, command: Command, why: ImError) -> None:
        """Bring the action of a command in doubt."""
        for activity in executor.activities:
            job = activity.lineage.job
            if activity.transition == name and (job is None or job.command == command):
                executor.rule.move(activity, ActivityState.IN_DOUBT, why)
                return

    def _fields_read(self, transition: Transition, context: ActionContext, draws: Draws) -> dict[str, object]:
        """Draw the fields of an answer that the net reads."""
        action, at = transition.action, ("answers", transition.retry_of or transition.name)
        message = f"{action.type}{_TYPES[type(action)]}" if isinstance(action, _ANSWERED) else ""
        return self._values.fields(message, at, context.answer_ways, draws) if context.answer_ways else {}

    def _answer(
        self, key: str, transition: Transition, fields: Mapping[str, object], context: ActionContext
    ) -> AnswerFile:
        written = self._written(key)
        if written is None:
            return _BY_ITSELF if self._draws is None else self._drawn(self._draws, key, transition, context)
        given = {**context.request_arguments, **fields}
        for each in written:
            if each.when and each.when.items() <= given.items():
                return each
        plain = [each for each in written if not each.when] or [_BY_ITSELF]
        self._used[key] += 1
        return plain[min(self._used[key], len(plain)) - 1]

    def _written(self, key: str) -> Sequence[AnswerFile] | None:
        return self._file.answers.get(key) or self._file.answers.get(key.partition(".")[2])

    def _drawn(self, draws: Draws, key: str, transition: Transition, context: ActionContext) -> AnswerFile:
        """Draw how an action ends, and whether its command is cancelled meanwhile."""
        takes = {} if transition.delay is not None and transition.delay.mean else {"after": 1.0}
        ends: list[dict[str, object]] = [{}, {}, {}, {"failure": "drawn"}]
        ends += [{"doubt": "drawn"}] if transition.on_doubt else []
        watches = tuple(key.split(".", 1)) in self._watches and isinstance(transition.action, AwaitAction)
        ends += [{"silent": True}] * (4 if watches else transition.timeout is not None)
        chosen = {**ends[draws.pick(len(ends))], **takes}
        if "failure" in chosen:
            chosen["code"] = [*self._values.texts[1:], "failed"][draws.pick(len(self._values.texts))]
        elif not chosen.keys() & {"doubt", "silent"} and (read := self._fields_read(transition, context, draws)):
            chosen["answer"] = read
        order = self._outcome.orders.get(context.command.id)
        if draws.pick(10) == 9 and order is not None and order.result is None:
            half = self._now + (0.5 if takes or transition.delay is None else transition.delay.mean / 2.0)
            self._timers.at(half, partial(self._cancel, order))
            self._outcome.script.steps.append({"at": half, "cancel": f"{order.net}.{order.name}"})
        self._outcome.script.answers.setdefault(key, []).append(chosen)
        return AnswerFile.model_validate(chosen)

    def _go_on(self, work: Coroutine[object, object, None]) -> None:
        """Run a coroutine until it pauses; it goes on when the pause is over."""
        self._paused.discard(work)
        try:
            pause = work.send(None)
        except StopIteration:
            return
        assert isinstance(pause, Pause)
        pause.then = partial(self._go_on, work)
        self._paused.add(work)  # else only a cycle holds it, for garbage collection to break

    # Guards.

    def watched(self, name: str, guard: GuardFunction, *, mocked: bool) -> GuardFunction:
        """Return a guard with mocked or noted answers."""

        def answer(context: ActionContext) -> bool:
            held = self._mocked(context.net, name) if mocked else bool(guard(context))
            self._coverage.guards[context.net, name].add(held)
            return held

        return answer

    def _mocked(self, net: str, name: str) -> bool:
        sequence = self._exchange.nets[net].sequence
        asked = self._asked.get((net, name))
        if asked is not None and asked[0] == sequence:
            return asked[1]
        if (written := self._guards.get(name)) is not None:
            self._used[name] += 1
            held = written[min(self._used[name], len(written)) - 1]
        elif self._draws is not None:
            held = self._draws.pick(2) == 1
            self._outcome.script.guards.setdefault(name, []).append(held)
        else:
            held = False
        self._asked[net, name] = sequence, held
        return held

    def is_mocked(self, name: str) -> bool:
        """Return whether a registered guard is mocked: each that is no function of a user's module, or is written."""
        return name in self._guards or ":" not in name


class _WatchedFunctions(Functions):
    """Functions of a scenario: actions, builders and guards without a module are mocked."""

    def __init__(self, run: ScenarioRunner, nets: Sequence[Net]) -> None:
        acting, others = set[str](), set[str]()
        for net in nets:
            for transition in net.transitions.values():
                if isinstance(action := transition.action, FunctionAction):
                    acting.add(action.function)
                elif action is not None:
                    others.update(action.functions)
        mocked: dict[str, Callable[..., object]] = {name: run.mock(name) for name in acting}
        for name in others:
            if ":" not in name:
                mocked[name] = lambda *_: {}
        guards = {name for net in nets for name in net.guards() if "${" not in name and run.is_mocked(name)}
        self._run, self._mocked = run, guards - {"cancelled", OTHERWISE}
        super().__init__(mocked, {name: lambda context: False for name in self._mocked})

    def question(self, guard: Guard) -> GuardFunction:
        """Return what a guard asks, mocked or watched."""
        return self._run.watched(guard.name, super().question(guard), mocked=guard.name in self._mocked)


class _ScenarioExchange(Exchange):
    """Exchange with a scenario in the place of nets that are not there."""

    def __init__(self, run: ScenarioRunner) -> None:
        super().__init__("scenario", 1, None, run)
        self._run = run

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Send a request to its net, or have it answered."""
        assert isinstance(activity.action, RequestAction)
        if activity.action.net in self.nets:
            super().send_request(activity, arguments)
        else:
            self._run.request(activity, arguments)

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Send a reply to its net, or to the scenario."""
        if not self._run.replied(request, error, results):
            super().send_reply(request, error, results)
