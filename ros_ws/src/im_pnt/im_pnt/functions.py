"""Registered actions and guards, and what they are told when called. A net names them; nothing is evaluated."""

from collections.abc import Awaitable, Callable, Mapping

from im_core.errors import ImError
from im_pnt.errors import NetFileError, nearest
from im_pnt.jobs import NO_COMMAND, Activity, Command, Lineage
from im_pnt.net import FunctionAction, GoalAction, Net, RequestAction, ServiceAction, Transition

ProgressSink = Callable[[Lineage, str, float], None]


class ActionContext:
    """What an action, builder, handler or guard is told.

    Attributes:
        net: Name of the net.
        transition: Name of the transition.
        command: Command of the tape it is done for; id 0 where there is none.
        failure: Failure that put a token on an input place of this transition, if any.
        last_failure: Last failure of any action done for the same command or request.
        request_arguments: Arguments of the request in work, or of the command.
        result: What the caller gets in the end; write into it.
        replies: Results of requests made earlier for the same job, by transition.
    """

    def __init__(
        self,
        net: str,
        transition: str,
        lineage: Lineage,
        activity: Activity | None = None,
        progress: ProgressSink | None = None,
    ) -> None:
        job = lineage.job
        self.net = net
        self.transition = transition
        self.command: Command = job.command if job else NO_COMMAND
        self.failure: ImError | None = lineage.failure
        self.last_failure: ImError | None = job.last_failure if job else lineage.failure
        self.request_arguments: dict[str, object] = job.arguments if job else {}
        self.result: dict[str, object] = job.results if job else {}
        self.replies: dict[str, dict[str, object]] = job.replies if job else {}
        self._lineage = lineage
        self._activity = activity
        self._progress = progress

    @property
    def cancelled(self) -> bool:
        """Whether the command, the request or this very action was cancelled."""
        job, activity = self._lineage.job, self._activity
        return bool((job and job.cancelled) or (activity and activity.cancelled))

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Has a function called when this action is cancelled; at once if it already is."""
        if self._activity is None:
            return
        if self._activity.cancelled:
            callback()
        else:
            self._activity.on_cancel.append(callback)

    def progress(self, text: str, fraction: float = -1.0) -> None:
        """Tells the client how far the command is.

        Args:
            text: What is being done.
            fraction: Progress 0..1, negative where unknown.
        """
        if self._progress is not None:
            self._progress(self._lineage, text, fraction)


ActionFunction = Callable[[ActionContext], object | Awaitable[object]]
GuardFunction = Callable[[ActionContext], bool]
HandleFunction = Callable[[ActionContext, object], object]


def cancelled(ctx: ActionContext) -> bool:
    """The guard that every net has: whether the command or request was cancelled."""
    return ctx.cancelled


class Functions:
    """The functions that nets may name.

    Args:
        actions: Actions, builders ``f(ctx) -> dict`` and handlers ``f(ctx, result)`` by name; plain or ``async``.
        guards: Enabling functions ``f(ctx) -> bool`` by name; ``cancelled`` is always there.
    """

    def __init__(
        self,
        actions: Mapping[str, Callable[..., object]] | None = None,
        guards: Mapping[str, GuardFunction] | None = None,
    ) -> None:
        self.actions: dict[str, Callable[..., object]] = dict(actions or {})
        self.guards: dict[str, GuardFunction] = {"cancelled": cancelled, **(guards or {})}

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
                case RequestAction(build=build) if build:
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
