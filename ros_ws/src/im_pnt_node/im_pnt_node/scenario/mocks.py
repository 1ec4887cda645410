"""Stand-ins of a scenario: pauses in virtual time, awaited messages, data objects."""

from collections.abc import Callable, Coroutine, Generator, Mapping, Sequence

from im_core.errors import ImError
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.timers import Timer
from im_pnt.execution.values import Done, run_at_once
from im_pnt.expression.template import Way
from im_pnt.model.action import AwaitAction

#: What scopes of commands of a scenario begin with.
SCOPE = "command-"


class Pause:
    """Pause of a coroutine, ended once."""

    def __init__(self) -> None:
        self.then: Callable[[], None] | None = None
        self._over = False

    def __await__(self) -> Generator["Pause", None, None]:
        if not self._over:
            yield self

    def wake(self) -> None:
        """End the pause."""
        self._over, then, self.then = True, self.then, None
        if then is not None:
            then()


class AwaitedMessage:
    """Wait for a message of a scenario.

    Args:
        action: The await.
        context: What its condition is over.
        empty: The fields that the net reads, empty.

    Attributes:
        pause: Ends with the first message that counts, or whose condition has no value.
        fields: Its fields, None: there was none.
        error: Why the condition has no value, or that its topic is silent.
        timer: Strikes when it may be.
    """

    def __init__(self, action: AwaitAction, context: ActionContext, empty: Mapping[str, object]) -> None:
        self._action, self._context, self._empty = action, context, empty
        self.pause = Pause()
        self.fields: dict[str, object] | None = None
        self.error: ImError | None = None
        self.timer: Timer | None = None

    def hear(self, message: Mapping[str, object]) -> None:
        """Take a message."""
        fields = completed(self._empty, message)
        try:
            if self._action.until is not None and not self._context.holds(self._action.until, fields):
                return
            self.fields = fields
        except ImError as error:
            self.error = error
        self.pause.wake()


class MockedObjects:
    """Data objects of a scenario (:class:`im_pnt.execution.values.Objects`).

    Each command stores objects of its own, as on the machine; the given ones are those of all commands.
    """

    def __init__(self, given: Mapping[str, Mapping[str, object]]) -> None:
        self._given = dict(given)
        self._stored: dict[str, Mapping[str, object]] = {}

    def give(self, given: Mapping[str, Mapping[str, object]]) -> None:
        """Replace objects of all commands, by name without scope."""
        self._given.update(given)
        self._stored = {name: fields for name, fields in self._stored.items() if _short(name) not in given}

    async def read(self, name: str, kind: str, ways: Sequence[Way]) -> Mapping[str, object]:
        """Return the fields of an object."""
        return self.latest(name, kind, ways)

    def latest(self, name: str, kind: str, ways: Sequence[Way]) -> Mapping[str, object]:
        """Return the fields of an object."""
        del kind, ways
        found = self._stored.get(name, self._given.get(_short(name)))
        if found is None:
            raise ImError(f"there is no data object '{_short(name)}' in the scenario", code="not_found")
        return found

    def stale(self) -> None:
        """Do nothing: every read is new."""

    async def put(self, name: str, kind: str, fields: Mapping[str, object], place: str = "") -> None:
        """Store an object."""
        del kind, place
        self._stored[name] = fields

    def run(self, work: Coroutine[object, object, None], done: Done) -> None:
        """Run a coroutine, which waits for nothing."""
        run_at_once(work, done)


def completed(empty: Mapping[str, object], given: Mapping[str, object]) -> dict[str, object]:
    """Return an answer with empty values for the fields that are left out, within its messages too."""
    fields = {**empty, **given}
    for name, value in given.items():
        before = empty.get(name)
        if isinstance(value, dict) and isinstance(before, dict):
            fields[name] = completed(before, value)
    return fields


def _short(name: str) -> str:
    return name.partition("/")[2] if name.startswith(SCOPE) else name
