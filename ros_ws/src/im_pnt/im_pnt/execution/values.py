"""Values of nets written as expressions, at run time: in requests, results, objects, and guards."""

from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Protocol

from im_core.errors import ImError, StateError
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.evaluation import Lookup, as_text
from im_pnt.expression.template import Way, filled, read_answers, read_objects
from im_pnt.model.net import Net

Done = Callable[[ImError | None], None]


class ObjectPendingError(ImError):
    """Error: a data object of a guard is being read; the guard is asked again afterwards."""

    default_code = "pending"


class Objects(Protocol):
    """Data objects, as seen by expressions; names are names in the Data Object Manager."""

    async def read(self, name: str, kind: str, ways: Sequence[Way]) -> Mapping[str, object]:
        """Return fields of a data object as JSON data.

        Args:
            name: Its name.
            kind: Its type, ``package/msg/Type``.
            ways: The ways to the fields; an empty one leads to all.

        Raises:
            ImError: There is none that is valid, or it is of another type.
        """

    def latest(self, name: str, kind: str, ways: Sequence[Way]) -> object:
        """Return fields of a data object at once, read since the last call of :meth:`stale`.

        Raises:
            ObjectPendingError: It is being read; guards are woken when it has been.
            ImError: As of :meth:`read`.
        """

    def stale(self) -> None:
        """Make :meth:`latest` read objects anew after a possible change by the last events."""

    async def put(self, name: str, kind: str, fields: Mapping[str, object], place: str = "") -> None:
        """Store a data object.

        Args:
            name: Its name.
            kind: Its type.
            fields: Its fields.
            place: ``net.place`` that stands for it, or empty.

        Raises:
            ImError: A field does not fit, or it was refused.
        """

    def run(self, work: Coroutine[object, object, None], done: Done) -> None:
        """Run a coroutine; on failure, call back with the reason."""


def run_at_once(work: Coroutine[object, object, None], done: Done) -> None:
    """Run a coroutine that waits for nothing; call back with the reason of a failure."""
    try:
        work.send(None)
    except StopIteration:
        done(None)
    except ImError as error:
        done(error)


class Told(Protocol):
    """Readable part of the context of an action or guard, for expressions."""

    @property
    def net(self) -> str:
        """Name of the net."""

    @property
    def transition(self) -> str:
        """Name of the transition."""

    def value(self, root: str, name: str) -> object:
        """Return an argument, an answer, or a fact of the failure or the command.

        Raises:
            ExpressionError: It is not there.
        """

    def object(self, name: str) -> str:
        """Return the name in the Data Object Manager of a data object."""


class NetValues:
    """The values of one net.

    Args:
        net: The net as written.
        objects: Its data objects; None: it has none here.

    Attributes:
        effective: Transitions that return or store values.
    """

    def __init__(self, net: Net, objects: Objects | None) -> None:
        self.effective = frozenset(t.name for t in net.transitions.values() if t.result or t.store)
        self._net, self._objects = net, objects
        self._ways = read_answers(net)
        self._guarded = any(read_objects(guard) for guard in net.guards())
        places = [place for place in net.places.values() if place.data_object is not None]
        self._kinds = {place.data_object: place.object_type for place in places if place.object_type is not None}
        self._places = {place.data_object: f"{net.name}.{place.name}" for place in reversed(places)}

    def ways(self, transition: str) -> tuple[Way, ...]:
        """Return the needed fields of the answer to a transition, as ways; an empty way: the whole answer."""
        return self._ways.get(self._answering(transition), ())

    def fill_now(self, value: object, told: Told, own: Mapping[str, object] | None = None) -> object:
        """Return a value with the expressions evaluated; data objects come from :meth:`Objects.latest`.

        Args:
            value: Plain data.
            told: What its transition is told.
            own: What its own action was just answered.

        Raises:
            ImError: An expression has no value.
            ObjectPendingError: A data object is still to be read.
        """
        objects = {}
        for name, ways in read_objects(value).items():
            objects[name] = self._known_objects().latest(told.object(name), self._kinds[name], ways)
        return self._filled(value, told, objects, own)

    def stale(self) -> None:
        """Make guards read the data objects anew."""
        if self._guarded and self._objects is not None:
            self._objects.stale()

    async def fill(self, value: object, told: Told, own: Mapping[str, object] | None = None) -> object:
        """Return a value with the expressions evaluated; arguments and errors as of :meth:`fill_now`.

        Raises:
            ImError: An expression has no value, or a data object is not there.
        """
        objects = {}
        for name, ways in read_objects(value).items():
            objects[name] = await self._known_objects().read(told.object(name), self._kinds[name], ways)
        return self._filled(value, told, objects, own)

    def tell(self, text: str, told: Told, tell: Callable[[str], None]) -> None:
        """Hand over a text with the expressions evaluated, or as written where an expression has no value.

        Args:
            text: The text.
            told: What its transition is told.
            tell: Called with it; at once where no data object is in it.
        """
        if self._objects is None or not read_objects(text):
            try:
                shown = as_text(self.fill_now(text, told))
            except ImError:  # an index beyond the end of a list
                shown = text
            tell(shown)
            return
        found = [text]

        async def read() -> None:
            found.append(as_text(await self.fill(text, told)))

        self._objects.run(read(), lambda _: tell(found[-1]))

    def conclude(self, told: Told, result: dict[str, object], own: Mapping[str, object], done: Done) -> None:
        """Return and store the values of a transition after the good end of the action.

        Args:
            told: What it is told.
            result: What its caller gets.
            own: What its action was answered.
            done: Called with why that failed, if it has; at once where no data object has to do with it.
        """
        written = self._net.transitions[told.transition]
        if written.store or read_objects(dict(written.result)):
            work = self._conclude_later(told, result, own)
            try:
                self._known_objects().run(work, done)
            except ImError as error:
                work.close()
                done(error)
            return
        try:
            result.update(self._mapping(self.fill_now(dict(written.result), told, own)))
        except ImError as error:
            done(error)
        else:
            done(None)

    async def _conclude_later(self, told: Told, result: dict[str, object], own: Mapping[str, object]) -> None:
        written = self._net.transitions[told.transition]
        result.update(self._mapping(await self.fill(dict(written.result), told, own)))
        for name, value in written.store.items():
            fields = await self.fill(value, told, own)
            if not isinstance(fields, dict):
                raise ImError(f"store.{name} of transition {told.transition} is not a mapping", code="expression")
            await self._known_objects().put(told.object(name), self._kinds[name], fields, self._places[name])

    def _filled(
        self, value: object, told: Told, objects: Mapping[str, object], own: Mapping[str, object] | None
    ) -> object:
        try:
            answered = {} if own is None else {self._answering(told.transition): own}
            return filled(value, _lookup(told, objects, answered))
        except ExpressionError as error:
            text = f"transition {told.transition} of net {told.net}: {error}"
            raise ImError(text, code="expression", net=told.net, transition=told.transition) from error

    def _answering(self, transition: str) -> str:
        """Return the transition credited with another one's answer: of a further try, the first one."""
        return self._net.transitions[transition].retry_of or transition

    def _known_objects(self) -> Objects:
        if self._objects is None:
            raise StateError(f"net {self._net.name} uses data objects, but runs without a Data Object Manager")
        return self._objects

    def _mapping(self, value: object) -> dict[str, object]:
        assert isinstance(value, dict)
        return value


def _lookup(told: Told, objects: Mapping[str, object], own: Mapping[str, object]) -> Lookup:
    def value(root: str, name: str) -> object:
        if root == "data":
            return objects[name]
        if root == "answers" and name in own:
            return own[name]
        return told.value(root, name)

    return value
