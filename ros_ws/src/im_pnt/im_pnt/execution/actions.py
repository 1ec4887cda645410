"""Has the actions of nets done: registered functions here, requests through the exchange, the rest where it belongs."""

import inspect
from collections.abc import Awaitable, Callable, Coroutine, Mapping

from im_core.clock import monotonic
from im_core.errors import ImError
from im_pnt.action import Action, FunctionAction, RequestAction
from im_pnt.doubt import Answer, Verdict
from im_pnt.exchange import Exchange
from im_pnt.executive import Executive
from im_pnt.functions import ActionContext, ActionFunction, Functions
from im_pnt.jobs import Activity, as_failure
from im_pnt.record import plain_dict

GRACE_S = 1.0
"""Time that an action which cannot be asked has to end by itself, once it is in doubt [s]."""

Perform = Callable[[Activity, ActionContext], Coroutine[object, object, None]]
"""Carries out an action of one kind; raises where it fails."""

Ask = Callable[[Activity, ActionContext], Awaitable[Answer]]
"""Finds out what became of an action of one kind."""

Spawn = Callable[[Coroutine[object, object, None]], None]
"""Has a coroutine run; it never raises."""


class FunctionRunner:
    """Runs actions without blocking.

    A plain function is called at once, in the loop, and must return quickly; whatever waits is ``async def``.

    Args:
        functions: The registered functions.
        exchange: Carries requests.
        spawn: Runs coroutines in the loop.
        others: For each further class of action what carries it out (service calls, goals, topics).
        asks: For those of them that can be asked about, what finds out what became of one.
        clock: Present time, that of the nets [s].
    """

    def __init__(
        self,
        functions: Functions,
        exchange: Exchange,
        spawn: Spawn,
        others: Mapping[type, Perform] | None = None,
        asks: Mapping[type, Ask] | None = None,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._functions = functions
        self._exchange = exchange
        self._spawn = spawn
        self._others = dict(others or {})
        self._asks = dict(asks or {})
        self._clock = clock
        self._running: set[Activity] = set()

    def start(self, executive: Executive, activity: Activity, context: ActionContext) -> None:
        """Starts an action; its end is reported to the executive."""
        action = activity.action
        try:
            if isinstance(action, FunctionAction):
                outcome = self._functions.actions[action.function](context)
                if inspect.isawaitable(outcome):
                    self.watch(executive, activity, outcome)
                else:
                    executive.ended(activity, None)
            elif isinstance(action, RequestAction):
                outcome = self._functions.actions[action.build](context) if action.build else {}
                if not inspect.isawaitable(outcome):
                    self._request(executive, activity, context, outcome)
                    return
                self._spawn(self._request_later(executive, activity, context, outcome))
            elif type(action) in self._others:
                self.watch(executive, activity, self._others[type(action)](activity, context))
            else:
                executive.ended(activity, ImError(f"{action} cannot be done here: it needs a ROS node", code="runner"))
        except Exception as error:  # an action is foreign code: whatever it raises is its failure
            executive.ended(activity, as_failure(activity, error))

    def direct(self, action: Action) -> ActionFunction | None:
        """Returns the function that does an action when it is called."""
        if not isinstance(action, FunctionAction):
            return None
        function = self._functions.actions[action.function]
        return None if inspect.iscoroutinefunction(function) else function

    def watch(self, executive: Executive, activity: Activity, work: Awaitable[object]) -> None:
        """Waits for what an action has left to do."""
        self._running.add(activity)
        self._spawn(self._watch(executive, activity, work))

    def waits(self, activity: Activity) -> bool:
        """Whether a request has been sent, and its reply is still to come."""
        return self._exchange.book.of_activity(activity) is not None

    def ask(
        self, executive: Executive, activity: Activity, context: ActionContext, answered: Callable[[Answer], None]
    ) -> None:
        """Asks what became of an action: its ask function, the net that was asked, or itself for a while."""
        action = activity.action
        asking: Answer | Awaitable[Answer]
        if isinstance(action, FunctionAction) and action.function in self._functions.asks:
            asking = self._functions.asks[action.function](context)
        elif isinstance(action, RequestAction):
            asking = self._ask_net(activity, action)
        elif type(action) in self._asks:
            asking = self._asks[type(action)](activity, context)
        else:
            asking = self._wait_a_little(activity)
        if inspect.isawaitable(asking):
            self._spawn(self._answer_later(activity, asking, answered))
        else:
            answered(_as_answer(activity, asking))

    def _ask_net(self, activity: Activity, action: RequestAction) -> Answer:
        if self.waits(activity):  # its reply is sure to come, or the death of its node to be noticed
            return Answer(Verdict.RUNNING, asked=f"net {action.net}")
        return Answer(Verdict.UNKNOWN, asked=f"net {action.net} owes no reply")

    def _wait_a_little(self, activity: Activity) -> Answer:
        if activity in self._running and self._clock() - activity.doubted < GRACE_S:
            return Answer(Verdict.RUNNING, asked="itself")
        left = f"it had {GRACE_S:g} s to end by itself" if activity in self._running else "it is not running here"
        return Answer(Verdict.UNKNOWN, asked=f"{activity.action} cannot be asked, and {left}")

    async def _answer_later(
        self, activity: Activity, asking: Awaitable[Answer], answered: Callable[[Answer], None]
    ) -> None:
        try:
            answered(_as_answer(activity, await asking))
        except Exception as error:  # asking is foreign code too
            answered(Answer(Verdict.UNKNOWN, asked=f"asking broke: {as_failure(activity, error)}"))

    async def _watch(self, executive: Executive, activity: Activity, work: Awaitable[object]) -> None:
        try:
            await work
        except Exception as error:  # likewise
            executive.ended(activity, as_failure(activity, error))
        else:
            executive.ended(activity, None)
        finally:
            self._running.discard(activity)

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
        if executive.record is not None:
            arguments = plain_dict(arguments, f"the arguments of {action}")
        if activity not in executive.activities:
            return
        before = len(activity.on_cancel)
        self._exchange.send_request(executive, activity, arguments)
        if activity.cancelled:  # while the arguments were made
            for callback in activity.on_cancel[before:]:
                callback()


def _as_answer(activity: Activity, answer: object) -> Answer:
    if isinstance(answer, Answer):
        return answer
    return Answer(Verdict.UNKNOWN, asked=f"asked about {activity.action}, its function returned {answer!r:.80}")
