"""Starts the actions of nets: registered functions here, requests through the exchange, the rest where it belongs."""

import inspect
from collections.abc import Awaitable, Callable, Coroutine, Mapping

from im_core.errors import ImError
from im_pnt.exchange import Exchange
from im_pnt.executive import Executive
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import Activity
from im_pnt.net import FunctionAction, RequestAction

Perform = Callable[[Activity, ActionContext], Coroutine[object, object, None]]
"""Carries out an action of one kind; raises where it fails."""

Spawn = Callable[[Coroutine[object, object, None]], None]
"""Has a coroutine run; it never raises."""


class FunctionRunner:
    """Runs actions without blocking.

    A plain function is called at once, in the loop, and must return quickly; whatever waits is ``async def``.

    Args:
        functions: The registered functions.
        exchange: Carries requests.
        spawn: Runs coroutines in the loop.
        others: For each further class of action what carries it out (service calls, goals).
    """

    def __init__(
        self,
        functions: Functions,
        exchange: Exchange,
        spawn: Spawn,
        others: Mapping[type, Perform] | None = None,
    ) -> None:
        self._functions = functions
        self._exchange = exchange
        self._spawn = spawn
        self._others = dict(others or {})

    def start(self, executive: Executive, activity: Activity, context: ActionContext) -> None:
        """Starts an action; its end is reported to the executive."""
        action = activity.action
        try:
            if isinstance(action, FunctionAction):
                outcome = self._functions.actions[action.function](context)
                if not inspect.isawaitable(outcome):
                    executive.ended(activity, None)
                    return
                self._spawn(self._watch(executive, activity, _discarding(outcome)))
            elif isinstance(action, RequestAction):
                outcome = self._functions.actions[action.build](context) if action.build else {}
                if not inspect.isawaitable(outcome):
                    self._request(executive, activity, context, outcome)
                    return
                self._spawn(self._request_later(executive, activity, context, outcome))
            elif type(action) in self._others:
                self._spawn(self._watch(executive, activity, self._others[type(action)](activity, context)))
            else:
                executive.ended(activity, ImError(f"{action} cannot be done here: it needs a ROS node", code="runner"))
        except Exception as error:  # an action is foreign code: whatever it raises is its failure
            executive.ended(activity, as_failure(activity, error))

    async def _watch(self, executive: Executive, activity: Activity, work: Coroutine[object, object, None]) -> None:
        try:
            await work
        except Exception as error:  # likewise
            executive.ended(activity, as_failure(activity, error))
        else:
            executive.ended(activity, None)

    async def _request_later(
        self, executive: Executive, activity: Activity, context: ActionContext, building: Awaitable[object]
    ) -> None:
        try:
            self._request(executive, activity, context, await building)
        except Exception as error:  # likewise
            executive.ended(activity, as_failure(activity, error))

    def _request(self, executive: Executive, activity: Activity, context: ActionContext, built: object) -> None:
        action = activity.action
        assert isinstance(action, RequestAction)
        if not isinstance(built, dict):
            raise ImError(f"builder {action.build} returned {built!r}, not a dict of arguments", code="builder")
        arguments = {**action.fields, **built}
        if not action.build and not action.fields:
            arguments = dict(context.request_arguments)
        self._exchange.send_request(executive, activity, arguments)


async def _discarding(outcome: Awaitable[object]) -> None:
    await outcome


def as_failure(activity: Activity, error: Exception) -> ImError:
    """Returns an exception of an action as the failure that the net will carry."""
    if isinstance(error, ImError):
        return error
    return ImError(
        f"{activity.action} of transition {activity.transition} broke: {type(error).__name__}: {error}",
        code="action",
        net=activity.net,
        transition=activity.transition,
    )
