"""Events and entries as JSON: the one form in which the journal, the link and a re-run have them.

An event or entry is a list of its tag in :data:`TAGS` and its fields in order: ``["fire", transition, job]``. Any other
class is a list of its fields, an enumeration its value. Three types have their own form: an error is what
:func:`im_pnt.errors.encode_error` makes, a job is its command, and :data:`.entries.Json` is JSON already.

Fields are written and read by the types that their classes declare, so data of another type are refused.
"""

import dataclasses
import enum
import functools
import json
import types
import typing
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Generic, NamedTuple, TypeVar

from im_core.errors import ImError
from im_pnt.errors import NetError, decode_error, encode_error
from im_pnt.execution import events, jobs, journal_entries
from im_pnt.execution.journal_entries import NetEntry, plain_dict
from im_pnt_node.distributed import entries

ValueT = TypeVar("ValueT")

TAGS: Mapping[type, str] = {
    events.CommandWritten: "command",
    events.CommandCancelled: "cancel",
    events.CommandHeld: "hold",
    events.RequestArrived: "request",
    events.RequestCancelled: "request_cancelled",
    events.RequestHeld: "request_held",
    events.TokenArrived: "token",
    events.JobUpdateArrived: "tiding",
    events.NodeForgotten: "node_forgotten",
    events.ModeSet: "mode",
    events.PauseSet: "pause",
    events.BreakpointSet: "breakpoint",
    jobs.JobData: "data",
    journal_entries.JobChange: "change",
    journal_entries.ActivityEnded: "ended",
    journal_entries.TransitionFired: "fire",
    journal_entries.PhaseFired: "phase",
    journal_entries.EndFired: "end",
    journal_entries.MessageBuilt: "built",
    journal_entries.GuardBroke: "guard",
    journal_entries.JobForgotten: "forgotten",
    journal_entries.VisitSettled: "settled",
    entries.ReplyArrived: "reply",
    entries.EventPosted: "posted",
    entries.RequestAsked: "asked",
    entries.RequestAnswered: "answered",
    entries.RequestClosed: "closed",
    entries.RequestsRenamed: "renamed",
    entries.TokenKept: "undeliverable",
    entries.MessageSent: "out",
    entries.MessageTaken: "in",
    entries.MessagesAcknowledged: "acked",
    entries.MessageRefused: "refused",
    entries.MessageVoided: "void",
    entries.IncarnationBegun: "begin",
    entries.NumbersSkipped: "move",
    entries.EpochRaised: "epoch",
}

_JSON_ALREADY = (jobs.JobData, journal_entries.ActivityEnded)
"""Classes with dictionaries that were made by :func:`.plain_dict`: it does not check them twice."""

encode_json = json.JSONEncoder(separators=(",", ":")).encode
_quoted = functools.lru_cache(maxsize=4096)(encode_json)


class _Form(NamedTuple):
    """Form of a type.

    Attributes:
        write: Makes JSON of a value.
        read: Makes a value of JSON data; raises ValueError for those of another type.
    """

    write: Callable[[Any], str]
    read: Callable[[Any], Any]


class Codec(Generic[ValueT]):
    """Codec of a type.

    Attributes:
        encode: Makes JSON of a value; raises NetError where JSON cannot carry a part of it.
    """

    def __init__(self, kind: object, name: str) -> None:
        form = _form(kind)
        self.encode: Callable[[ValueT], str] = form.write
        self._read, self._name = form.read, name

    def content(self, value: ValueT) -> Any:
        """Return a value as JSON data.

        Raises:
            NetError: JSON cannot carry a part of it.
        """
        return json.loads(self.encode(value))

    def decode(self, content: object) -> ValueT:
        """Return the value of JSON data.

        Raises:
            NetError: It is none.
        """
        try:
            value: ValueT = self._read(content)
        except (ValueError, RecursionError) as error:
            raise NetError(f"{str(content)[:200]} is no {self._name}: {error}") from error
        return value


@functools.cache
def _form(kind: Any) -> _Form:
    origin = typing.get_origin(kind) or kind
    if origin in _FORMS:
        return _FORMS[origin]
    if origin in (types.UnionType, typing.Union):
        return _union(typing.get_args(kind))
    if origin is tuple:
        return _sequence(_form(typing.get_args(kind)[0]))
    if issubclass(kind, enum.Enum):
        return _Form(lambda value: _quoted(value.value), kind)
    return _fields(kind)


def _union(kinds: Iterable[Any]) -> _Form:
    """Return the form of several classes with tags, or of one type; with None or without."""
    classes = [kind for kind in kinds if kind is not types.NoneType]
    write, read = _tagged(classes) if len(classes) > 1 else _form(classes[0])
    if types.NoneType not in kinds:
        return _Form(write, read)
    return _Form(
        lambda value: "null" if value is None else write(value),
        lambda content: None if content is None else read(content),
    )


def _tagged(classes: Iterable[type]) -> _Form:
    forms = {kind: _fields(kind, TAGS[kind]) for kind in classes}
    writers = {kind: form.write for kind, form in forms.items()}
    readers = {TAGS[kind]: form.read for kind, form in forms.items()}

    def read(content: object) -> object:
        tag = content[0] if isinstance(content, list) and content else None
        if not isinstance(tag, str) or tag not in readers:
            raise ValueError(f"{str(content)[:200]} begins with none of {', '.join(readers)}")
        return readers[tag](content)

    return _Form(lambda value: writers[type(value)](value), read)


def _fields(kind: Any, tag: str = "") -> _Form:
    """Return the form of a class: the list of its fields, behind its tag."""
    hints = typing.get_type_hints(kind)
    names = kind._fields if issubclass(kind, tuple) else [field.name for field in dataclasses.fields(kind)]
    forms = {name: _form(hints[name]) for name in names}
    if kind not in _JSON_ALREADY:
        forms |= {name: _checked(name, form) for name, form in forms.items() if form is _FORMS[dict]}
    readers, first = [form.read for form in forms.values()], 1 if tag else 0
    # One expression, as the constructors of dataclasses are made: every firing is written, and a loop takes three times
    # as long.
    texts = [f'"{tag}"'] * first + [f"{{write_{name}(value.{name})}}" for name in names]
    writers = {f"write_{name}": form.write for name, form in forms.items()}
    write: Callable[[Any], str] = eval(f"lambda value: f'[{','.join(texts)}]'", writers)

    def read(content: object) -> object:
        parts = content[first:] if isinstance(content, list) else ()
        if len(parts) != len(readers):
            raise ValueError(f"{str(content)[:200]} is not a list of {', '.join(names)}")
        return kind(*[read(part) for read, part in zip(readers, parts, strict=True)])

    return _Form(write, read)


def _sequence(item: _Form) -> _Form:
    def read(content: object) -> tuple[object, ...]:
        if not isinstance(content, list):
            raise ValueError(f"{str(content)[:200]} is no list")
        return tuple(map(item.read, content))

    return _Form(lambda values: f"[{','.join(map(item.write, values))}]", read)


def _checked(name: str, form: _Form) -> _Form:
    return _Form(lambda value: form.write(plain_dict(value, name)) if value else "{}", form.read)


def _scalar(kind: type, write: Callable[[Any], str]) -> _Form:
    def read(content: object) -> object:
        if type(content) is not kind:
            raise ValueError(f"{str(content)[:200]} is no {kind.__name__}")
        return content

    return _Form(write, read)


def _read_error(content: object) -> ImError:
    error = decode_error(content)
    if error is None:
        raise ValueError("it says no reason")
    return error


def _read_job(content: object) -> jobs.Job:
    command = _form(jobs.Command).read(content)
    return jobs.Job(command, command.arguments)


_FORMS: Mapping[object, _Form] = {
    str: _scalar(str, _quoted),
    int: _scalar(int, str),
    bool: _scalar(bool, {True: "true", False: "false"}.__getitem__),
    float: _scalar(float, encode_json),
    list: _scalar(list, encode_json),
    dict: _scalar(dict, encode_json),
    entries.Json: _Form(str, encode_json),
    ImError: _Form(lambda error: encode_json(encode_error(error)), _read_error),
    jobs.Job: _Form(lambda job: _form(jobs.Command).write(job.command), _read_job),
}

NET_ENTRY: Codec[NetEntry] = Codec(NetEntry, "entry of a net")
DELIVERY: Codec[entries.Delivery] = Codec(entries.Delivery, "event")
EXCHANGE_ENTRY: Codec[entries.ExchangeEntry] = Codec(entries.ExchangeEntry, "entry of an exchange")
LINK_ENTRY: Codec[entries.LinkEntry] = Codec(entries.LinkEntry, "entry of a link")
COMMAND: Codec[jobs.Command] = Codec(jobs.Command, "command")
REQUEST: Codec[jobs.Request] = Codec(jobs.Request, "request")
ANSWER: Codec[events.Answer] = Codec(events.Answer, "answer")
REPLY: Codec[jobs.Reply] = Codec(jobs.Reply, "reply")
VISIT: Codec[jobs.Visit] = Codec(jobs.Visit, "visit")
