"""Registered actions and guards, and what they are told when called. A net names them; nothing is evaluated."""

import inspect
import math
from collections.abc import Awaitable, Callable, Mapping

from im_core.errors import ImError, nearest
from im_pnt.errors import NetError, NetFileError
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.jobs import NO_COMMAND, NO_LINEAGE, Activity, Command, Lineage
from im_pnt.model.action import FunctionAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.net import Net, Transition

ProgressSink = Callable[[Lineage, str, float], None]


class ActionContext:
    """What an action, builder, handler or guard is told.

    What it holds belongs to a command or request; where there is none, it is this call's own.

    Attributes:
        net: Name of the net.
        transition: Name of the transition.
        used: Whether something is in it that the next call of a function must not find.
    """

    __slots__ = ("_activity", "_begun", "_lineage", "_own", "_progress", "net", "transition", "used")

    def __init__(
        self,
        net: str,
        transition: str,
        lineage: Lineage = NO_LINEAGE,
        activity: Activity | None = None,
        progress: ProgressSink | None = None,
        begun: Callable[[], Activity | None] | None = None,
    ) -> None:
        self.net = net
        self.transition = transition
        self.used = False
        self._lineage = lineage
        self._activity = activity
        self._begun = begun
        self._progress = progress
        self._own: dict[str, dict[str, object]] = {}

    @property
    def command(self) -> Command:
        """Command of the tape it is done for; id 0 where there is none."""
        job = self._lineage.job
        return job.command if job is not None else NO_COMMAND

    @property
    def failure(self) -> ImError | None:
        """Failure that put a token on an input place of this transition, if any."""
        return self._lineage.failure

    @property
    def last_failure(self) -> ImError | None:
        """Last failure of any action done for the same command or request."""
        job = self._lineage.job
        return job.last_failure if job is not None else self._lineage.failure

    @property
    def request_arguments(self) -> dict[str, object]:
        """Arguments of the request in work, or of the command."""
        job = self._lineage.job
        return job.arguments if job is not None else self._private("arguments")

    @property
    def result(self) -> dict[str, object]:
        """What the caller gets in the end; write into it."""
        job = self._lineage.job
        return job.results if job is not None else self._private("results")

    @property
    def replies(self) -> dict[str, dict[str, object]]:
        """Results of requests made earlier for the same job, by transition."""
        job = self._lineage.job
        return job.replies if job is not None else {}

    @property
    def memory(self) -> dict[str, object]:
        """What the actions of a command or request keep for each other; plain JSON data, never sent to the caller."""
        job = self._lineage.job
        return job.memory if job is not None else self._private("memory")

    @property
    def cancelled(self) -> bool:
        """Whether the command, the request or this very action was cancelled."""
        job, activity = self._lineage.job, self._activity
        return (job is not None and job.cancelled) or (activity is not None and activity.cancelled)

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Has a function called when this action is cancelled; at once if it already is."""
        if self._activity is None and self._begun is not None:
            self.bind(self._begun())
        if self._activity is not None:
            self._activity.when_cancelled(callback)

    def progress(self, text: str, fraction: float = -1.0) -> None:
        """Tells the client how far the command is.

        Args:
            text: What is being done.
            fraction: Progress 0..1, negative where unknown.
        """
        if self._progress is not None:
            self._progress(self._lineage, text, fraction)

    def bind(self, activity: Activity | None) -> None:
        """Gives it the action that it speaks of."""
        self.used, self._activity = True, activity

    def _private(self, what: str) -> dict[str, object]:
        self.used = True
        return self._own.setdefault(what, {})


ActionFunction = Callable[[ActionContext], object | Awaitable[object]]
GuardFunction = Callable[[ActionContext], bool]
AskFunction = Callable[[ActionContext], Answer | Awaitable[Answer]]

_SOURCES = ("data", "topic", "clock")
_WOKEN_BY = "__woken_by__"


def woken_by(*sources: str) -> Callable[[GuardFunction], GuardFunction]:
    """Declares what a guard depends on: it is asked again when one of these fires, and not at every event of the net.

    Args:
        *sources: ``data:<object>``, ``topic:<name>`` or ``clock:<period in s>``.

    Raises:
        NetError: There is no such source.
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
    """Returns the period of a clock among the sources of a guard [s], None for other sources.

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
    """Returns what finds out about an action that may be done twice, for its effect is the same: it is done again."""

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
    """The guard that every net has: whether the command or request was cancelled."""
    return ctx.cancelled


class Functions:
    """The functions that nets may name.

    Args:
        actions: Actions, builders ``f(ctx) -> dict`` and handlers ``f(ctx, result)`` by name; plain or ``async``.
        guards: Enabling functions ``f(ctx) -> bool`` by name; ``cancelled`` is always there.
        asks: For actions by name, functions ``f(ctx) -> Answer`` that find out what became of them, plain or ``async``.

    Raises:
        NetError: There is no action of the name of an ask function.
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

    def sources(self, guard: str) -> frozenset[str] | None:
        """Returns what wakes a guard, None where it does not say."""
        declared: frozenset[str] | None = getattr(self.guards[guard], _WOKEN_BY, None)
        return declared

    def wakes(self, net: Net) -> frozenset[str]:
        """Returns what wakes the guards of a net."""
        return frozenset(source for guard in net.guards() for source in self.sources(guard) or ())

    def check(self, net: Net) -> None:
        """Checks that every function a net names is registered.

        Raises:
            NetFileError: One is not; names file, line and the nearest right name.
        """
        for transition in net.transitions.values():
            if transition.guard and transition.guard.name not in self.guards:
                raise _missing(net, transition, "guard", transition.guard.name, self.guards)
            match transition.action:
                case FunctionAction(function):
                    names = [function]
                case ServiceAction(build=build, handle=handle) | GoalAction(build=build, handle=handle):
                    names = [name for name in (build, handle) if name]
                case RequestAction(build=build) | TopicAction(build=build) if build:
                    names = [build]
                case _:
                    names = []
            for name in names:
                if name not in self.actions:
                    raise _missing(net, transition, "action", name, self.actions)


def _missing(net: Net, transition: Transition, kind: str, name: str, known: Mapping[str, object]) -> NetFileError:
    return NetFileError(
        net.source,
        transition.line,
        f"transitions.{transition.name}: no {kind} function '{name}' is registered{nearest(name, known)}",
    )
