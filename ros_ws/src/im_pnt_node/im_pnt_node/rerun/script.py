"""Stand-in for the world in a re-run: functions of nets read from the recording."""

from collections import deque
from collections.abc import Callable, Collection, Coroutine, Generator
from typing import Any, Protocol, TypeVar

from im_core.errors import ImError
from im_pnt.execution.executor import Executor
from im_pnt.execution.jobs import Activity
from im_pnt.execution.values import Objects
from im_pnt.model.net import Net
from im_pnt_node.rerun.entries import error_of
from im_pnt_node.rerun.log import Key
from im_pnt_node.rerun.stream import NodeStream, named

ValueT = TypeVar("ValueT")
MessageT = TypeVar("MessageT")
Work = Coroutine[Any, Any, None]
Place = tuple[int, int]
"""Where an item is in a recording: the rank of its turn, and its own in that."""
Differs = Callable[[Activity | None, str, str, str], BaseException]
"""Makes a difference: of an action, what the bag has, what there is now, and why."""


class Messages(Protocol):
    """Messages and the JSON data."""

    def packed(self, message: object) -> list[str]:
        """Return the data of a message."""

    def unpacked(self, data: str, kind: type[MessageT]) -> MessageT:
        """Return the message of CDR in base64."""

    def difference(self, recorded: object, now: object) -> str:
        """Return the first difference of JSON data, with messages compared as messages; empty for equal data."""


class Reading:
    """Placeholder of an awaited input."""

    def __init__(self, key: str) -> None:
        self.key = key

    def __await__(self) -> Generator["Reading", object, object]:
        """Yield the placeholder to the script, and return the value."""
        return (yield self)


class _NotRecorded(BaseException):
    """Signal of a step beyond the recording, which may end before the action does."""


class Script:
    """Runner of coroutines; each goes on once the recording has come to the awaited input.

    One whose action has not ended where the recording does goes as far as that tells what it did.

    Raises:
        DataError: What was recorded makes no sense.

    Attributes:
        label: The action that is begun now, or goes on.
        at: The item of the recording that is taken: the rank of its turn, and its own in that.
    """

    def __init__(self, stream: NodeStream, differs: Differs, messages: Messages) -> None:
        self._differs, self._messages = differs, messages
        self.label: Activity | None = None
        self.at = (0, 0)
        self._ready: deque[tuple[Work, Activity | None]] = deque()
        self._waiting: dict[str, deque[tuple[Work, Activity | None]]] = {}
        self._spare: dict[str, deque[tuple[object, ImError | None]]] = {}
        self._noted: dict[str, deque[tuple[Place, object, ImError | None]]] = {}
        self._sent: dict[str, deque[tuple[Place, object]]] = {}
        self._ended: set[tuple[str, int]] = set()
        self._advancing = False
        for number, turn in enumerate(stream.turns):
            for rank, item in enumerate(turn.items):
                match item:
                    case ["noted", list(key), value, error]:
                        told = (number, rank), value, error_of(error)
                        self._noted.setdefault(named(key), deque()).append(told)
                    case ["net", str(net), ["ended", int(action), *_]]:
                        self._ended.add((net, action))
                    case ["sent", list(key), content]:
                        self._sent.setdefault(named(key), deque()).append(((number, rank), content))

    # For the one who runs the nets.

    def spawn(self, work: Work) -> None:
        """Run a coroutine from the next turn on, for the action under way."""
        self._ready.append((work, self.label))

    def step(self) -> None:
        """Run spawned coroutines until all wait."""
        while self._ready:
            self._advance(*self._ready.popleft(), None, None)

    def resume(self, key: Key, value: object, error: ImError | None) -> None:
        """Resume the waiting coroutine with the recorded input."""
        name = named(key)
        if waiting := self._waiting.get(name):
            self._advance(*waiting.popleft(), value, error)
        else:
            self._spare.setdefault(name, deque(maxlen=100)).append((value, error))

    def waits_for(self, activity: Activity) -> str:
        """Return the awaited input of an action; empty: none."""
        found = (key for key, waiting in self._waiting.items() if any(label is activity for _, label in waiting))
        return " ".join(next(found, "").split("\x00"))

    def left_unsent(self, kind: str, activity: Activity) -> object | None:
        """Return the recorded requests without a present counterpart."""
        left = self._sent.get(named([kind, activity.net, activity.number]))
        return left[0][1] if left else None

    def never_sent(self, kinds: Collection[str]) -> tuple[str, object] | None:
        """Return the recorded requests of some kinds without a present counterpart, in words; None: there are none."""
        for name, left in self._sent.items():
            words = name.split("\x00")
            if left and words[0] in kinds:
                return " ".join(words), left[0][1]
        return None

    def forget_unasked(self) -> None:
        """Forget recorded inputs and requests without a present counterpart: the origin is not repeated."""
        self._spare.clear()
        for noted in self._noted.values():
            while noted and noted[0][0] < self.at:
                noted.popleft()
        for sent in self._sent.values():
            while sent and sent[0][0] < self.at:
                sent.popleft()

    # For who stands for the node.

    async def wait(self, key: Key) -> Any:
        """Wait for the recorded input at the place, and return the input.

        Raises:
            ImError: Why it was not read, if so.
        """
        return await Reading(named(key))

    def noted(self, key: Key) -> Any:
        """Return a recorded value.

        Raises:
            ImError: Why it could not be, if so.
        """
        known = self._noted.get(named(key))
        if not known:
            self._require_ended()
            what = " ".join(map(str, key))
            raise self._differs(self.label, "nothing more of that", f"its function asks for {what}", "another function")
        _, value, error = known.popleft()
        if error is not None:
            raise error
        return value

    def sent(self, key: Key, content: object) -> None:
        """Compare a request with the recorded one."""
        known, what = self._sent.get(named(key)), " ".join(map(str, key))
        if not known:
            self._require_ended()
            now = f"{what}: {str(content)[:160]}"
            raise self._differs(self.label, "nothing of that kind", now, "another request")
        _, recorded = known.popleft()
        if recorded != content and (where := self._messages.difference(recorded, content)):
            then, _, now = where.rpartition(", now ")
            raise self._differs(self.label, f"{what}: {then}", now, "another request")

    def _require_ended(self) -> None:
        """Stop at an action without a recorded end: the later steps are unknown."""
        if self._advancing and self.label is not None and (self.label.net, self.label.number) not in self._ended:
            raise _NotRecorded

    def _advance(self, work: Work, label: Activity | None, value: object, error: ImError | None) -> None:
        before, self.label, self._advancing = (self.label, self._advancing), label, True
        try:
            while True:
                reading = work.throw(error) if error is not None else work.send(value)
                assert isinstance(reading, Reading)
                spare = self._spare.get(reading.key)
                if not spare:
                    self._waiting.setdefault(reading.key, deque()).append((work, label))
                    return
                value, error = spare.popleft()
        except (StopIteration, _NotRecorded):
            return
        finally:
            self.label, self._advancing = before


class ScriptObjects:
    """Data objects of the recording."""

    def __init__(self, script: Script, messages: Messages) -> None:
        self._script, self._messages = script, messages

    async def get(self, name: str, message_type: type[MessageT]) -> MessageT:
        """Return the object read in the recording."""
        _, data = await self._script.wait(["get", name])
        return self._messages.unpacked(data, message_type)

    async def put(self, name: str, message: object, place: str = "") -> int:
        """Compare a stored object with the recorded one."""
        self._script.sent(["put", name], self._messages.packed(message))
        return int(await self._script.wait(["put", name]))

    async def append(self, name: str, message: object) -> int:
        """Compare an appended message with the recorded one."""
        self._script.sent(["append", name], self._messages.packed(message))
        return int(await self._script.wait(["append", name]))

    async def is_valid(self, name: str) -> bool:
        """Whether the object was valid then."""
        return bool(await self._script.wait(["valid", name]))

    async def invalidate(self, name: str) -> None:
        """Declare an object invalid, if the recording does."""
        self._script.sent(["invalidate", name], None)
        await self._script.wait(["invalidate", name])


class ScriptHost:
    """Stands for a node (:class:`im_pnt_node.rerun.host.Host`).

    Attributes:
        heard: The last message of each topic, with its type, as recorded so far.
        values: The data objects as JSON data; the runner of the nets sets them.
        recorded: Nobody records what is run again.
    """

    recorded = False
    values: Objects

    def __init__(
        self, name: str, script: Script, messages: Messages, executors: dict[str, Executor], nets: dict[str, Net]
    ) -> None:
        self.name, self._script, self._messages = name, script, messages
        self.dom = ScriptObjects(script, messages)
        self.heard: dict[str, object] = {}
        self._executors, self._nets = executors, nets

    def last(self, topic: str) -> Any:
        """Return the last message of a topic, None before the first."""
        return self.heard.get(topic)

    def parameter(self, name: str) -> Any:
        """Return a recorded parameter."""
        return self._script.noted(["parameter", name])

    def incarnation(self, task: str) -> int | None:
        """Return the recorded incarnation of a task."""
        found: int | None = self._script.noted(["life", task])
        return found

    async def ask(self, service_type: type, service: str, request: object, task: str, what: str) -> Any:
        """Return the recorded answer, for an unchanged question."""
        self._script.sent(["ask", service], self._messages.packed(request))
        _, data = await self._script.wait(["ask", service])
        response: Any = service_type
        return self._messages.unpacked(data, response.Response)

    async def pause(self, seconds: float) -> None:
        """Let the recorded events of the pause happen."""
        await self._script.wait(["pause"])

    def noted(self, key: str, compute: Callable[[], ValueT]) -> ValueT:
        """Return a recorded value."""
        value: ValueT = self._script.noted([key])
        return value

    async def noted_apart(self, key: str, compute: Callable[..., ValueT], *arguments: object) -> ValueT:
        """Return a recorded value."""
        value: ValueT = await self._script.wait([key])
        return value

    def warn(self, text: str) -> None:
        """Write nothing: the recorded run has written the line."""

    def executor(self, net: str) -> Executor:
        """Return a net in execution."""
        return self._executors[net]

    def nets(self) -> list[Net]:
        """Return the nets, as written."""
        return list(self._nets.values())
