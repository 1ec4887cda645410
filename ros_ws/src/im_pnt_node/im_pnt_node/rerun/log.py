"""Events of a node for a re-run: all inputs of the nets, and all the effects, in order.

Items are JSON lists::

    ["node", name, functions]              who tells, and what makes its functions (``module:function``, or empty)
    ["state", net, state, yaml]            a net as recording begins, or as it is loaded, and the text of its file
    ["net", net, entry]                    an entry of its journal (:mod:`im_pnt_node.distributed.codec`)
    ["heard", topic, type, CDR]            a message of a topic that guards look at
    ["object", name, valid]                a data object that has changed
    ["noted", key, value, error]           what a function has read, at once: a time, a file
    ["read", key, value, error]            what a function has waited for: a data object, an answer
    ["sent", key, content]                 what was asked for: a request, a goal, a data object stored

CDR is base64. A key is a list: ``["get", object]``, ``["answer", net, number of the action]`` and so on.
"""

import inspect
from base64 import b64encode
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

from im_core.errors import ImError
from im_pnt.errors import encode_error
from im_pnt.execution.events import Answer
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity
from im_pnt.execution.runner import Ask, Requests
from im_pnt_node.distributed.codec import ANSWER, encode_json

ValueT = TypeVar("ValueT")
Key = Sequence[object]


class MissionLog:
    """Collector of events for a re-run.

    Attributes:
        items: Not told yet, as JSON texts.
        recorded: Whether somebody listens.
    """

    def __init__(self) -> None:
        self.items: list[str] = []
        self.recorded = False

    def add(self, *item: object) -> None:
        """Add an item."""
        self.items.append(encode_json(list(item)))

    def noted(self, key: Key, compute: Callable[[], ValueT]) -> ValueT:
        """Return a value computed from the world outside, such as a time; JSON data. A failure is noted, too.

        Raises:
            ImError: As ``compute`` does.
        """
        try:
            value = compute()
        except ImError as error:
            self.add("noted", key, None, encode_error(error))
            raise
        self.add("noted", key, value, None)
        return value

    async def read(self, key: Key, work: Awaitable[ValueT], content: Callable[[ValueT], object]) -> ValueT:
        """Wait for an input from outside, and note the input, or the failure.

        Raises:
            ImError: As ``work`` does.
        """
        try:
            value = await work
        except ImError as error:
            self.add("read", key, None, encode_error(error))
            raise
        self.add("read", key, content(value), None)
        return value

    def sent(self, key: Key, content: object) -> None:
        """Note a request, JSON data."""
        self.add("sent", key, content)


def packed(kind: str, data: bytes) -> list[str]:
    """Return a message as JSON data: the type, and the CDR in base64."""
    return [kind, b64encode(data).decode()]


class NotedRequests:
    """Requests to other nets, noted on sending."""

    def __init__(self, requests: Requests, log: MissionLog) -> None:
        self._requests, self._log = requests, log

    def send_request(self, activity: Activity, arguments: dict[str, object]) -> None:
        """Send a request."""
        self._log.sent(["request", activity.net, activity.number], [str(activity.action), arguments])
        self._requests.send_request(activity, arguments)

    def awaits_reply(self, activity: Activity) -> bool:
        """Return whether a sent request still awaits the reply."""
        return self._requests.awaits_reply(activity)


def noted_answers(ask: Ask, log: MissionLog) -> Ask:
    """Return a question about actions in doubt with noted answers."""

    async def asked(activity: Activity, context: ActionContext) -> Answer:
        async def work() -> Answer:
            found = ask(activity, context)
            return await found if inspect.isawaitable(found) else found

        return await log.read(["asked", activity.net, activity.number], work(), ANSWER.content)

    return asked
