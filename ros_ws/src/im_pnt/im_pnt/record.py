"""What a net in execution tells its journal, as plain JSON lists.

The ``record`` of an executive (None: no journal) is called with one entry *before* what it tells is done: before tokens
move, before an action begins, before tokens and replies leave, before a client is answered. Where it raises, nothing
was done.

Taken from the inbox, in the spelling of :mod:`im_pnt.deliveries`::

    ["command", id, symbol, arguments]                 a command on the input tape
    ["request", [id, net, service, caller_node, caller_net, caller_transition, [id, symbol, arguments], arguments]]
    ["token", place, count]                            tokens of another net
    ["cancel", id | null, error]                       a command, or everything, should end early
    ["request_cancelled", request, error]              so should a request
    ["ended", number, error | null, results]           an action has ended (not: a plain function)
    ["mode", name]  ["pause", bool]                    how the net is operated

Firings of the expanded net; ``number`` is that of an activity (``Activity.number``), the sequence number of its
``t.start``::

    ["fire", transition]                               any that only moves tokens, those of a coordination structure,
                                                       and ``t.start``, which makes an activity
    ["phase", number, transition, error]               t.cancel, t.lost, t.lost.cancelling
    ["end", number, transition, error | null, data | null]
                                                       t.end*, t.failed*, t.given_up; ``data``: what its job holds now,
                                                       if that has changed: [memory, results, progress]

And what a net decides beside firing::

    ["guard", job, error]                              a guard broke; ``job`` is its number
    ["forgotten", job, error]                          the net came to rest and left a command open

An ``error`` is what :func:`im_pnt.remote.encode_error` makes. Replaying the entries in their order gives the same
marking, lineages, tape, jobs, activities and numbers:

1. ``restore(state)`` where there is a state, and ``replay(entry)`` for each since, both before anything is posted.
   They start nothing, ask no guard and tell no observer, but they do call ``Outlet.send_token`` and ``send_reply`` as
   the entries demand, in their order.
2. ``activity(number)`` finds the activity that a request of the exchange's own records belongs to.
3. ``resume()``: requests that the exchange has in its book go on waiting (``Runner.waits``), those that it has not
   are started again, for they had not left; an activity that had ended ends; every other comes in doubt and is asked
   about.

``state()`` may be called between two calls of ``pump``; it is JSON data, and nothing else should look into it.
"""

import json
import math
from collections.abc import Callable

from im_pnt.errors import NetError
from im_pnt.jobs import Command, Job, Request

Entry = list[object]
Record = Callable[[Entry], None]


def plain(value: object, where: str) -> object:
    """Returns a copy of a value as JSON data; a tuple becomes a list.

    Args:
        value: The value.
        where: What it is, for the message.

    Raises:
        NetError: It has a part that JSON cannot carry; names the part.
    """
    try:
        return _plain(value, where)
    except RecursionError:
        raise NetError(f"{where} is nested too deeply, or contains itself; a journal cannot keep it") from None


def _plain(value: object, where: str) -> object:
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return float(value)
    if isinstance(value, list | tuple):
        return [_plain(item, f"{where}[{number}]") for number, item in enumerate(value)]
    if isinstance(value, dict):
        for key in value:
            if not isinstance(key, str):
                raise NetError(f"{where} has the key {key!r}; a journal keeps dictionaries whose keys are strings")
        return {key: _plain(item, f"{where}.{key}") for key, item in value.items()}
    raise NetError(
        f"{where} is {value!r:.80} ({type(value).__name__}); a journal keeps None, bool, int, finite float, str, "
        "list and dict",
        where=where,
    )


def plain_dict(value: object, where: str) -> dict[str, object]:
    """Returns a copy of a dictionary as JSON data.

    Raises:
        NetError: It is no dictionary, or has a part that JSON cannot carry.
    """
    copy = plain(value, where)
    if not isinstance(copy, dict):
        raise NetError(f"{where} is {value!r:.80}, not a dictionary")
    return copy


def data_of(job: Job) -> list[object]:
    """Returns memory, results and progress of a job as JSON data.

    Raises:
        NetError: They have a part that JSON cannot carry.
    """
    return [plain(job.memory, "ctx.memory"), plain(job.results, "ctx.result"), float(job.progress)]


def changed_data(job: Job) -> list[object] | None:
    """Returns the data of a job, None where they are as they were the last time.

    Raises:
        NetError: They have a part that JSON cannot carry.
    """
    data = data_of(job)
    text = json.dumps(data)
    if text == job.recorded:
        return None
    job.recorded = text
    return data


def take_data(job: Job, data: object) -> None:
    """Gives a job its data back.

    Raises:
        NetError: They are none.
    """
    match data:
        case [dict(memory), dict(results), float(progress)]:
            job.recorded, job.progress = json.dumps(data), progress
            for mine, kept in ((job.memory, memory), (job.results, results)):
                mine.clear()
                mine.update(kept)
        case _:
            raise NetError(f"{str(data)[:200]} is not what a job holds")


def restore_data(job: Job) -> None:
    """Gives a job the data that were written last."""
    take_data(job, json.loads(job.recorded))


def encode_command(command: Command) -> Entry:
    """Writes a command."""
    where = f"the arguments of command {command.symbol}"
    return [command.id, command.symbol, plain(command.arguments, where)]


def encode_request(request: Request) -> Entry:
    """Writes a request."""
    return [
        request.id,
        request.net,
        request.service,
        request.caller_node,
        request.caller_net,
        request.caller_transition,
        encode_command(request.command),
        plain(request.arguments, f"the arguments of request {request.id}"),
    ]


def decode_command(content: object) -> Command:
    """Reads a command.

    Raises:
        NetError: It is none.
    """
    match content:
        case [int(number), str(symbol), dict(arguments)]:
            return Command(number, symbol, arguments)
    raise NetError(f"{str(content)[:200]} is no command")


def decode_request(content: object) -> Request:
    """Reads a request.

    Raises:
        NetError: It is none.
    """
    match content:
        case [str(name), str(net), str(service), str(node), str(caller), str(by), command, dict(arguments)]:
            return Request(name, net, service, node, caller, by, decode_command(command), arguments)
    raise NetError(f"{str(content)[:200]} is no request")
