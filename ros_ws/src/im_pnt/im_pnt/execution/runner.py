"""Runner of actions: functions in the loop, requests to other nets, and further kinds from a node."""

import inspect
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import FOREIGN, ImError
from im_pnt.execution.actions import ActionOwner
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext, ActionFunction, Functions
from im_pnt.execution.jobs import Activity, as_failure
from im_pnt.execution.journal_entries import plain_dict
from im_pnt.expression.template import read_objects
from im_pnt.model.action import Action, FunctionAction, RequestAction, ValuesAction


class Requests(Protocol):
    """Carries requests to other nets."""

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Send a request; the reply, or the cause of a missing one, ends the activity."""

    def awaits_reply(self, activity: Activity) -> bool:
        """Return whether the request of an activity still awaits the reply."""


GRACE_S = 1.0
"""Time that an action which cannot be asked has to end by itself, once it is in doubt [s]."""

Perform = Callable[[Activity, ActionContext], Coroutine[object, object, dict[str, object]]]
"""Carries out an action of one kind, and returns what is kept of its answer; raises where it fails."""

Ask = Callable[[Activity, ActionContext], Answer | Awaitable[Answer]]
"""Finds out what became of an action of one kind."""

Spawn = Callable[[Coroutine[object, object, None]], None]
"""Has a coroutine run; it never raises."""

Apart = Callable[[ActionFunction, ActionContext], Coroutine[object, object, None]]
"""Calls a function in a thread of its own, for a context; raises what that raises."""


class FunctionRunner:
    """Runs actions without blocking.

    A plain function is called at once, in the loop, and must return quickly; whatever waits is ``async def``. One of a
    user's module, ``module:function``, is called in a thread of its own, and may take its time.

    Args:
        functions: The registered functions.
        requests: Carries requests.
        spawn: Runs coroutines in the loop.
        others: For each further class of action what carries it out (service calls, goals, topics).
        asks: For those of them that can be asked about, what finds out what became of one.
        clock: Present time, that of the nets [s].
        apart: Calls functions in threads; None: all are called in the loop.
    """

    def __init__(
        self,
        functions: Functions,
        requests: Requests,
        spawn: Spawn,
        others: Mapping[type, Perform] | None = None,
        asks: Mapping[type, Ask] | None = None,
        clock: Callable[[], float] = monotonic,
        apart: Apart | None = None,
    ) -> None:
        self._functions = functions
        self._requests = requests
        self._spawn = spawn
        self._others = dict(others or {})
        self._asks = dict(asks or {})
        self._clock = clock
        self._apart = apart
        self._running: set[Activity] = set()

    def start(self, owner: ActionOwner, activity: Activity, context: ActionContext) -> None:
        """Start an action; the end is reported to the owner."""
        action = activity.action
        try:
            if isinstance(action, FunctionAction):
                function = self._functions.actions[action.function]
                apart = self._apart if self._is_apart(action) else None
                outcome = function(context) if apart is None else apart(function, context)
                assert inspect.isawaitable(outcome), "every other function is called directly"
                self.watch(owner, activity, outcome)
            elif isinstance(action, RequestAction):
                outcome = self._functions.actions[action.build](context) if action.build else {}
                if not inspect.isawaitable(outcome) and not read_objects(action.fields):
                    self._request(owner, activity, context, context.filled_now(action.fields), outcome)
                    return
                self._spawn(self._request_later(owner, activity, context, outcome))
            elif isinstance(action, ValuesAction):
                owner.ended(activity, None)
            elif type(action) in self._others:
                self._running.add(activity)
                self._spawn(self._perform(owner, activity, self._others[type(action)](activity, context)))
            else:
                owner.ended(activity, ImError(f"{action} cannot be done here: it needs a ROS node", code="runner"))
        except FOREIGN as error:  # an action is foreign code: whatever it raises is its failure
            owner.ended(activity, as_failure(activity, error))

    def direct(self, action: Action) -> ActionFunction | None:
        """Return the function of an action for a direct call."""
        if not isinstance(action, FunctionAction) or self._is_apart(action):
            return None
        function = self._functions.actions[action.function]
        return None if inspect.iscoroutinefunction(function) else function

    def watch(self, owner: ActionOwner, activity: Activity, work: Awaitable[object]) -> None:
        """Wait for the remaining work of an action."""
        self._running.add(activity)
        self._spawn(self._watch(owner, activity, work))

    def waits(self, activity: Activity) -> bool:
        """Return whether a sent request still awaits the reply."""
        return self._requests.awaits_reply(activity)

    def ask(
        self, owner: ActionOwner, activity: Activity, context: ActionContext, answered: Callable[[Answer], None]
    ) -> None:
        """Ask for the outcome of an action: the ask function, the asked net, or for a while the action."""
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

    def _is_apart(self, action: FunctionAction) -> bool:
        function = self._functions.actions[action.function]
        return self._apart is not None and action.is_imported and not inspect.iscoroutinefunction(function)

    def _ask_net(self, activity: Activity, action: RequestAction) -> Answer:
        if self.waits(activity):  # its reply is sure to come, or the death of its node to be noticed
            return Answer(Outcome.RUNNING, asked=f"net {action.net}")
        return Answer(Outcome.UNKNOWN, asked=f"net {action.net} owes no reply")

    def _wait_a_little(self, activity: Activity) -> Answer:
        if activity in self._running and self._clock() - activity.doubted < GRACE_S:
            return Answer(Outcome.RUNNING, asked="itself")
        left = f"it had {GRACE_S:g} s to end by itself" if activity in self._running else "it is not running here"
        return Answer(Outcome.UNKNOWN, asked=f"{activity.action} cannot be asked, and {left}")

    async def _answer_later(
        self, activity: Activity, asking: Awaitable[Answer], answered: Callable[[Answer], None]
    ) -> None:
        try:
            answered(_as_answer(activity, await asking))
        except FOREIGN as error:  # asking is foreign code too
            answered(Answer(Outcome.UNKNOWN, asked=f"asking broke: {as_failure(activity, error)}"))

    async def _watch(self, owner: ActionOwner, activity: Activity, work: Awaitable[object]) -> None:
        try:
            await work
        except FOREIGN as error:  # likewise
            owner.ended(activity, as_failure(activity, error))
        else:
            owner.ended(activity, None)
        finally:
            self._running.discard(activity)

    async def _perform(
        self, owner: ActionOwner, activity: Activity, work: Coroutine[object, object, dict[str, object]]
    ) -> None:
        try:
            owner.ended(activity, None, await work)
        except FOREIGN as error:  # likewise
            owner.ended(activity, as_failure(activity, error))
        finally:
            self._running.discard(activity)

    async def _request_later(
        self, owner: ActionOwner, activity: Activity, context: ActionContext, built: object
    ) -> None:
        try:
            assert isinstance(activity.action, RequestAction)
            fields = await context.filled(activity.action.fields)
            self._request(owner, activity, context, fields, await built if inspect.isawaitable(built) else built)
        except FOREIGN as error:  # likewise
            owner.ended(activity, as_failure(activity, error))

    def _request(
        self, owner: ActionOwner, activity: Activity, context: ActionContext, fields: object, built: object
    ) -> None:
        action = activity.action
        assert isinstance(action, RequestAction)
        assert isinstance(fields, dict)
        if not isinstance(built, dict):
            raise ImError(f"builder {action.build} returned {built!r}, not a dict of arguments", code="builder")
        arguments = {**fields, **built}
        if not action.build and not action.fields:
            arguments = dict(context.request_arguments)
        if owner.record is not None:
            arguments = plain_dict(arguments, f"the arguments of {action}")
        if not owner.runs(activity):
            return
        owner.built(activity)
        before = len(activity.on_cancel)
        self._requests.send_request(activity, arguments)
        if activity.cancelled:  # while the arguments were made
            for callback in activity.on_cancel[before:]:
                callback()


def _as_answer(activity: Activity, answer: object) -> Answer:
    if isinstance(answer, Answer):
        return answer
    return Answer(Outcome.UNKNOWN, asked=f"asked about {activity.action}, its function returned {answer!r:.80}")
