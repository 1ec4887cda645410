"""Functions named in nets, by a registered name or as ``module:function``, and the arguments."""

import inspect
import math
from collections.abc import Awaitable, Callable, Iterable, Mapping, MutableMapping
from typing import Any

from im_core import plugins
from im_core.errors import FOREIGN, ConfigError, ImError, nearest
from im_pnt.errors import NetError, NetFileError
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.jobs import NO_COMMAND, NO_LINEAGE, Activity, Command, Lineage, object_name, scope_of
from im_pnt.execution.values import NetValues, ObjectPendingError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.template import OPENS, read_objects
from im_pnt.model.net import Guard, Net, Transition

ProgressSink = Callable[[Lineage, str, float], None]
JsonObject = dict[str, object]
Plain = object
"""A value of JSON, perhaps with expressions in it."""


class ActionContext:
    """Context of an action, builder, handler or guard.

    What it holds belongs to a command or request; where there is none, it is this call's own.

    >>> context = ActionContext("oven", "bake")
    >>> context.result["degrees"] = 220
    >>> context.result, context.command.id, context.cancelled
    ({'degrees': 220}, 0, False)
    """

    __slots__ = (
        "_activity",
        "_lineage",
        "_own",
        "_progress",
        "_shared",
        "_values",
        "net",
        "transition",
    )

    def __init__(
        self,
        net: str,
        transition: str,
        lineage: Lineage = NO_LINEAGE,
        activity: Activity | None = None,
        progress: ProgressSink | None = None,
        shared: Iterable[str] = (),
        values: NetValues | None = None,
    ) -> None:
        self.net = net
        self.transition = transition
        self._lineage = lineage
        self._activity = activity
        self._progress = progress
        self._shared = shared
        self._values = values
        self._own: dict[str, dict[str, object]] = {}

    @property
    def command(self) -> Command:
        """Command of the tape behind the action; id 0 without one."""
        job = self._lineage.job
        return job.command if job is not None else NO_COMMAND

    def object(self, name: str) -> str:
        """Return the name in the DOM of a data object of the command.

        Args:
            name: Name among the objects of the command, as other nets that work for it call it, too, or as the net
                has it, with arguments; that of an object of the machine has ``/`` before it, or a place of the net
                declares it to be global.
        """
        job = self._lineage.job
        arguments = {} if job is None else job.arguments
        return object_name(name, scope_of(self.net, self.command), self._shared, arguments)

    @property
    def failure(self) -> ImError | None:
        """Failure on a token of an input place of the transition, if any."""
        return self._lineage.failure

    @property
    def last_failure(self) -> ImError | None:
        """Last failure of any action done for the same command or request."""
        job = self._lineage.job
        return job.last_failure if job is not None else self._lineage.failure

    @property
    def request_arguments(self) -> JsonObject:
        """Arguments of the request in work, or of the command."""
        job = self._lineage.job
        return job.arguments if job is not None else self._private("arguments")

    @property
    def result(self) -> JsonObject:
        """Result for the caller at the end; open for writing."""
        job = self._lineage.job
        return job.results if job is not None else self._private("results")

    @property
    def replies(self) -> dict[str, JsonObject]:
        """Answers of earlier actions for the same job, by transition.

        That is the results of requests, and of other answers the fields that some expression of the net reads.
        """
        job = self._lineage.job
        return job.replies if job is not None else {}

    @property
    def memory(self) -> JsonObject:
        """Memory shared by the actions of a command or request; plain JSON data, never sent to the caller."""
        job = self._lineage.job
        return job.memory if job is not None else self._private("memory")

    @property
    def cancelled(self) -> bool:
        """Whether the command, the request or the very action was cancelled."""
        job, activity = self._lineage.job, self._activity
        return (job is not None and job.cancelled) or (activity is not None and activity.cancelled)

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call a function at the cancellation of the action; at once if already cancelled."""
        if self._activity is not None:
            self._activity.when_cancelled(callback)

    def progress(self, text: str, fraction: float = -1.0) -> None:
        """Report the progress of the command to the client.

        Args:
            text: What is being done.
            fraction: Progress 0..1, negative where unknown.
        """
        if self._progress is not None:
            self._progress(self._lineage, text, fraction)

    def value(self, root: str, name: str) -> Plain:
        """Return the value of ``arguments.NAME``, ``answers.NAME``, ``failure.NAME`` or ``command.NAME``.

        Raises:
            ExpressionError: It is not there.
        """
        failure, command = self.failure, self.command
        match root, name:
            case "arguments", _:
                known, why = self.request_arguments, "it was not given"
            case "answers", _:
                known, why = dict(self.replies), "there is no answer for this command yet"
            case "failure", "code" | "message":
                return "" if failure is None else failure.code if name == "code" else failure.message
            case "command", "id" | "symbol":
                return command.id if name == "id" else command.symbol
            case _:
                known, why = {}, "there is none"
        if name not in known:
            raise ExpressionError(f"{root}.{name}: {why}")
        return known[name]

    @property
    def answer_ways(self) -> tuple[tuple[str, ...], ...]:
        """Fields to keep of the answer to the transition, as ways to the fields."""
        return () if self._values is None else self._values.ways(self.transition)

    async def filled(self, value: Plain) -> Plain:
        """Return a value of the net file with the expressions evaluated.

        Raises:
            ImError: One has no value.
        """
        return value if self._values is None else await self._values.fill(value, self)

    def filled_now(self, value: Plain) -> Plain:
        """Return the result of :meth:`filled` for a value without data objects."""
        return value if self._values is None else self._values.fill_now(value, self)

    def holds(self, condition: str, answer: Mapping[str, Plain]) -> bool:
        """Return whether a condition ``${...}`` of the net file holds after an answer to the transition.

        Raises:
            ImError: It has no value.
        """
        return self._values is None or self._values.fill_now(condition, self, answer) is True

    def _private(self, what: str) -> JsonObject:
        return self._own.setdefault(what, {})


ActionFunction = Callable[[ActionContext], object | Awaitable[object]]
GuardFunction = Callable[[ActionContext], bool]
AskFunction = Callable[[ActionContext], Answer | Awaitable[Answer]]

_SOURCES = ("data", "topic", "clock")
_WOKEN_BY = "__woken_by__"


def woken_by(*sources: str) -> Callable[[GuardFunction], GuardFunction]:
    """Declare the sources of a guard: only changes of a source, not all events of the net, evaluate the guard.

    Args:
        *sources: ``data:<object>``, ``topic:<name>`` or ``clock:<period in s>``.

    Raises:
        NetError: There is no such source.

    >>> @woken_by("data:tray", "clock:0.5")
    ... def is_tray_empty(ctx):
    ...     return True
    >>> sorted(Functions(guards={"is_tray_empty": is_tray_empty}).sources(Guard("is_tray_empty")))
    ['clock:0.5', 'data:tray']
    """
    for source in sources:
        kind, _, rest = source.partition(":")
        if kind not in _SOURCES or not rest:
            raise NetError(f"a guard cannot be woken by '{source}'; it can by data:NAME, topic:NAME or clock:SECONDS")
        if kind == "clock":
            clock_period(source)

    def declare(guard: GuardFunction) -> GuardFunction:
        setattr(guard, _WOKEN_BY, frozenset(sources))
        return guard

    return declare


def clock_period(source: str) -> float | None:
    """Return the period of a clock among the sources of a guard [s], None for other sources.

    Raises:
        NetError: It is no period.
    """
    kind, _, rest = source.partition(":")
    if kind != "clock":
        return None
    try:
        period = float(rest)
    except ValueError:
        period = math.nan
    if not 0.0 < period < math.inf:
        raise NetError(f"'{source}' has no period; a number of seconds > 0 is needed")
    return period


def idempotent(function: ActionFunction) -> AskFunction:
    """Return the question after a doubt for an action safe to do twice: do the action again.

    >>> asyncio.run(idempotent(functions.actions["heat"])(ActionContext("oven", "bake"))).outcome
    <Outcome.DONE: 'done'>
    """

    async def ask(context: ActionContext) -> Answer:
        try:
            outcome = function(context)
            if inspect.isawaitable(outcome):
                await outcome
        except ImError as error:
            return Answer(Outcome.FAILED, error, asked="it was done again")
        return Answer(Outcome.DONE, asked="it was done again")

    return ask


def cancelled(ctx: ActionContext) -> bool:
    """Return whether the command or request was cancelled; a guard of every net."""
    return ctx.cancelled


class Functions:
    """Functions for the names in nets.

    Args:
        actions: Actions, builders ``f(ctx) -> dict`` and handlers ``f(ctx, result)`` by name; plain or ``async``.
        guards: Enabling functions ``f(ctx) -> bool`` by name; ``cancelled`` is always there.
        asks: For actions by name, functions ``f(ctx) -> Answer`` that find out what became of them, plain or ``async``.

    Raises:
        NetError: There is no action of the name of an ask function.

    >>> Functions({"heet": print}).check(net)
    Traceback (most recent call last):
    im_pnt.errors.NetFileError: net:6: transitions.bake: no action function 'heat' is registered (did you mean 'heet'?)
    """

    def __init__(
        self,
        actions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
        asks: Mapping[str, AskFunction] | None = None,
    ) -> None:
        self.actions: dict[str, Callable[..., object]] = dict(actions or {})
        self.guards: dict[str, GuardFunction] = {"cancelled": cancelled, **(guards or {})}
        self.asks: dict[str, AskFunction] = dict(asks or {})
        for name in self.asks:
            if name not in self.actions:
                raise NetError(f"there is no action function '{name}' to ask about{nearest(name, self.actions)}")

    def sources(self, guard: Guard) -> frozenset[str] | None:
        """Return the sources of a guard, None without a declaration."""
        if guard.unless:
            known = [self.sources(each) for each in guard.unless]
            return None if None in known else frozenset[str]().union(*(each for each in known if each is not None))
        if OPENS in guard.name:
            return frozenset(f"data:{name}" for name in read_objects(guard.name))
        declared: frozenset[str] | None = getattr(self.guards[guard.name], _WOKEN_BY, None)
        return declared

    def wakes(self, net: Net) -> frozenset[str]:
        """Return the sources of the registered guards of a net."""
        named = (t.guard for t in net.transitions.values() if t.guard is not None and OPENS not in t.guard.name)
        return frozenset(source for guard in named for source in self.sources(guard) or ())

    def question(self, guard: Guard) -> GuardFunction:
        """Return the question of a guard, a registered function or an expression; a negation is left to the caller."""
        if not guard.unless:
            return self.guards.get(guard.name) or _expression_guard(guard.name)
        others = [(self.question(each), each.negated) for each in guard.unless]

        def otherwise(context: ActionContext) -> bool:
            return not any(_answer(guard, context) is not negated for guard, negated in others)

        return otherwise

    def check(self, net: Net) -> None:
        """Check whether every function of a net is registered; import functions named ``module:function``.

        Raises:
            NetFileError: One is not there; names file, line and the nearest right name.
        """
        for transition in net.transitions.values():
            for guard in () if transition.guard is None else transition.guard.unless or (transition.guard,):
                if OPENS not in guard.name:
                    _find(net, transition, "guard", guard.name, self.guards)
            for name in transition.action.functions if transition.action else ():
                _find(net, transition, "action", name, self.actions)


def _find(
    net: Net, transition: Transition, kind: str, name: str, known: MutableMapping[str, Callable[..., Any]]
) -> None:
    """Check whether a function is known."""
    if ":" not in name:
        if name in known:
            return
        sentence = f"no {kind} function '{name}' is registered{nearest(name, known)}"
        raise NetFileError(transition.file or net.source, transition.line, f"transitions.{transition.name}: {sentence}")
    try:
        plugins.require_current(name, f"{kind} function")
        found = known.get(name) or plugins.load(name, None, f"{kind} function")
        if not callable(found):
            raise ConfigError(f"{kind} function '{name}' is a {type(found).__name__}, which cannot be called")
    except ConfigError as error:
        sentence = f"transitions.{transition.name}: {error.message}"
        raise NetFileError(transition.file or net.source, transition.line, sentence) from error
    known[name] = found


def _answer(guard: GuardFunction, context: ActionContext) -> bool:
    """Return the answer of a guard; a broken one counts as false."""
    try:
        return bool(guard(context))
    except ObjectPendingError:
        raise
    except FOREIGN:  # told where the guard is asked for its own transition
        return False


def _expression_guard(text: str) -> GuardFunction:
    """Return the guard of an expression."""

    def guard(context: ActionContext) -> bool:
        return context.filled_now(text) is True

    return guard
