"""How a journal is written: each entry of a net, an exchange and a link as a JSON list, and back.

Of a net, ``["net", name, entry]``::

    ["command", id, symbol, arguments, priority, scope]    a command on the input tape; both only where it has them
    ["request", [id, net, service, caller_node, caller_net, caller_transition, command, arguments]]
    ["token", place, count]                            tokens of another net
    ["token", place, count, [job, symbol, command, arguments, home, node, net, failure, results, cancelled, held]]
                                                       of a job; it is told by its process, net and number there
    ["tiding", job, home, what, net, error | null, results]    what becomes of a job whose tokens have crossed
    ["node_forgotten", node, nets, error]              a node is gone for good
    ["settled", job]                                   nothing is left of a job of another net
    ["cancel", id | null, error]                       a command, or everything, should end early
    ["hold", id | null, bool, scope]                   nothing more is begun for a command, or for all that is here, or
                                                       it goes on; scope where it is known
    ["request_cancelled", request, error]              so should a request
    ["request_held", request, bool]                    nothing is begun for a request, or it goes on
    ["ended", number, error | null, results]  ["ended", number, error | null, results, data]    an action has ended
    ["built", number, data]                            what an action sends is made, and leaves after that
    ["mode", name]  ["pause", bool]                    how the net is operated
    ["fire", transition]  ["fire", transition, job]     for the job whose token is oldest, or for this one (0: none)
    ["phase", number, transition, error]
    ["end", number, transition, error | null, data | null]
    ["guard", job, error]
    ["forgotten", job, error]

``data`` is ``[memory, results, progress]``, or ``{"memory": difference, "results": difference, "progress": number}``
with what has changed (:func:`im_pnt.execution.journal_entries.difference`). An ``error`` is what
:func:`im_pnt.errors.encode_error` makes.

Of the exchange, ``["exchange", entry]``; a delivery is written as the net does that takes it::

    ["posted", net, delivery]
    ["asked", request, net, number, asked net, its node]
    ["answered", request]  ["closed", request]
    ["renamed", life]                                  how requests are named from then on
    ["undeliverable", net, place]

Of the link, ``["link", entry]``, where a message is its number and what
:func:`im_pnt_node.distributed.packets.encode_message` writes::

    ["out", node, message]  ["void", node, number]
    ["acked", node, number]  ["refused", node, number]
    ["in", node, number, refusal]
    ["begin", node, epoch, 0 | 1]  ["move", node, number]
    ["epoch", epoch]

Of the object store, as the answers of ``/dom`` tell of it, ``["store", "identity:number"]``: its last transaction.
"""

import functools
from collections.abc import Callable

from im_core.errors import ImError
from im_pnt.errors import NetError, decode_error, encode_error
from im_pnt.execution.events import (
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    JobUpdate,
    JobUpdateArrived,
    ModeSet,
    NodeForgotten,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    RequestHeld,
    TokenArrived,
)
from im_pnt.execution.jobs import Command, Job, JobData, JobKey, Owner, Request, TokenContext
from im_pnt.execution.journal_entries import (
    ActivityEnded,
    EndFired,
    GuardBroke,
    JobChange,
    JobForgotten,
    MessageBuilt,
    NetEntry,
    PhaseFired,
    TransitionFired,
    VisitSettled,
    plain,
)
from im_pnt.execution.operator import Mode
from im_pnt_node.distributed.entries import (
    Delivery,
    EventPosted,
    ExchangeEntry,
    RequestAnswered,
    RequestAsked,
    RequestClosed,
    RequestsRenamed,
    TokenKept,
)
from im_pnt_node.distributed.packets import decode_message, numbered
from im_pnt_node.distributed.streams import (
    EpochRaised,
    LifeBegun,
    LinkEntry,
    MessageRefused,
    MessagesAcknowledged,
    MessageSent,
    MessageTaken,
    MessageVoided,
    NumbersSkipped,
)
from im_pnt_node.journal.log import encode_json

_quoted = functools.lru_cache(maxsize=4096)(encode_json)


# Nets.


def net_encoder(net: str) -> Callable[[NetEntry], str]:
    """Return a writer for the entries of a net; templates write firings and tokens, nearly all entries.

    Args:
        net: Its name.

    Returns:
        A function that raises NetError where an entry has a part that JSON cannot carry.
    """
    prefix = f'["net",{encode_json(net)},'
    before_number = f'{prefix}["end",'
    fired: dict[str, str] = {}
    behind_number: dict[str, str] = {}
    arrived: dict[tuple[str, int], str] = {}

    def encode(entry: NetEntry) -> str:
        if isinstance(entry, TransitionFired):
            transition, job = entry
            text = fired.get(transition) if job is None else f"{prefix}{encode_json(encode_net_entry(entry))}]"
            if text is None:
                text = fired[transition] = f"{prefix}{encode_json(encode_net_entry(entry))}]"
            return text
        if isinstance(entry, EndFired):
            number, transition, failure, data = entry
            if failure is None and data is None:
                behind = behind_number.get(transition)
                if behind is None:
                    behind = behind_number[transition] = f",{encode_json(transition)},null,null]]"
                return f"{before_number}{number}{behind}"
        if isinstance(entry, TokenArrived) and entry.context is None:
            text = arrived.get((entry.place, entry.count))
            if text is None:
                text = arrived[entry.place, entry.count] = f"{prefix}{encode_json(encode_net_entry(entry))}]"
            return text
        try:
            return f"{prefix}{encode_json(encode_net_entry(entry))}]"
        except (TypeError, ValueError) as error:
            raise NetError(f"net {net}: what is to be journalled is not JSON data: {error}", net=net) from error

    return encode


def encode_net_entry(entry: NetEntry) -> list[object]:
    """Write an entry of a net, in the form read by :func:`decode_net_entry`.

    Raises:
        NetError: JSON cannot carry the arguments of a command or request.
    """
    match entry:
        case TransitionFired(transition, job):
            return ["fire", transition] if job is None else ["fire", transition, job]
        case EndFired(number, transition, failure, data):
            return ["end", number, transition, encode_error(failure), _data_fields(data)]
        case MessageBuilt(number, data):
            return ["built", number, _data_fields(data)]
        case PhaseFired(number, transition, error):
            return ["phase", number, transition, encode_error(error)]
        case CommandWritten(job):
            return ["command", *encode_command(job.command)]
        case CommandCancelled(command_id, error):
            return ["cancel", command_id, encode_error(error)]
        case ModeSet(mode):
            return ["mode", mode.value]
        case PauseSet(paused):
            return ["pause", paused]
        case GuardBroke(number, error):
            return ["guard", number, encode_error(error)]
        case JobForgotten(number, error):
            return ["forgotten", number, encode_error(error)]
        case VisitSettled(number):
            return ["settled", number]
        case _:
            return encode_delivery(entry)


def decode_net_entry(content: object) -> NetEntry:
    """Read an entry of a net.

    Raises:
        NetError: It is none.
    """
    try:
        match content:
            case ["fire", str(transition)]:
                return TransitionFired(transition)
            case ["fire", str(transition), int(job)]:
                return TransitionFired(transition, job)
            case ["end", int(number), str(transition), error, data]:
                return EndFired(number, transition, decode_error(error), _data_of(data))
            case ["built", int(number), data] if (kept := _data_of(data)) is not None:
                return MessageBuilt(number, kept)
            case ["phase", int(number), str(transition), error]:
                return PhaseFired(number, transition, _reason(error))
            case ["command", *written]:
                command = decode_command(written)
                return CommandWritten(Job(command, command.arguments))
            case ["cancel", None | int() as number, error]:
                return CommandCancelled(number, _reason(error))
            case ["mode", str(mode)]:
                return ModeSet(Mode(mode))
            case ["pause", bool(paused)]:
                return PauseSet(paused)
            case ["guard", int(number), error]:
                return GuardBroke(number, _reason(error))
            case ["forgotten", int(number), error]:
                return JobForgotten(number, _reason(error))
            case ["settled", int(number)]:
                return VisitSettled(number)
        return decode_delivery(content)
    except ValueError as error:
        raise NetError(f"{str(content)[:200]} is no entry of a net: {error}") from error


def encode_delivery(event: Delivery) -> list[object]:
    """Write an event in the inbox of a net, from an exchange.

    Raises:
        NetError: JSON cannot carry the arguments of a request.
    """
    match event:
        case TokenArrived(place, count, context):
            return ["token", place, count, *([] if context is None else [_encode_carried(context)])]
        case JobUpdateArrived(key, home, update, net, failure, results):
            told = plain(results, f"what net {net} tells")
            return ["tiding", [*key], home, update.value, net, encode_error(failure), told]
        case NodeForgotten(node, nets, error):
            return ["node_forgotten", node, [*nets], encode_error(error)]
        case RequestArrived(request):
            return ["request", encode_request(request)]
        case RequestCancelled(request_id, error):
            return ["request_cancelled", request_id, encode_error(error)]
        case RequestHeld(request_id, held):
            return ["request_held", request_id, held]
        case CommandHeld(command_id, held, scope):
            return ["hold", command_id, held, *([scope] if scope else [])]
        case ActivityEnded(number, failure, results, data):
            return ["ended", number, encode_error(failure), results, *([] if data is None else [_data_fields(data)])]


def decode_delivery(content: object) -> Delivery:
    """Read an event in the inbox of a net, from an exchange.

    Raises:
        ValueError: It is none.
        NetError: Likewise.
    """
    match content:
        case ["token", str(place), int(count)]:
            return TokenArrived(place, count)
        case ["token", str(place), int(count), context]:
            return TokenArrived(place, count, _decode_carried(context))
        case ["tiding", [str(process), str(of), int(job)], bool(home), str(what), str(net), error, dict(results)]:
            return JobUpdateArrived(JobKey(process, of, job), home, JobUpdate(what), net, decode_error(error), results)
        case ["node_forgotten", str(node), list(nets), error]:
            return NodeForgotten(node, tuple(map(str, nets)), _reason(error))
        case ["request", request]:
            return RequestArrived(decode_request(request))
        case ["request_cancelled", str(request_id), error]:
            return RequestCancelled(request_id, _reason(error))
        case ["request_held", str(request_id), bool(held)]:
            return RequestHeld(request_id, held)
        case ["hold", None | int() as number, bool(held), *scope]:
            return CommandHeld(number, held, *map(str, scope[:1]))
        case ["ended", int(number), error, dict(results), *data] if len(data) <= 1:
            return ActivityEnded(number, decode_error(error), results, _data_of(data[0] if data else None))
    raise ValueError(f"{str(content)[:200]} is no event")


def encode_owner(owner: Owner) -> list[object]:
    """Write the owner of a token from another net.

    Raises:
        NetError: JSON cannot carry the arguments.
    """
    arguments = plain(owner.arguments, f"the arguments of a job of net {owner.key.net}")
    return [[*owner.key], owner.symbol, encode_command(owner.command), arguments]


def decode_owner(content: object) -> Owner:
    """Read the owner of a token from another net.

    Raises:
        ValueError: It is nobody.
    """
    match content:
        case [[str(process), str(net), int(number)], str(symbol), command, dict(arguments)]:
            return Owner(JobKey(process, net, number), symbol, decode_command(command), arguments)
    raise ValueError(f"{str(content)[:200]} does not tell whose a token is")


def _encode_carried(context: TokenContext) -> list[object]:
    return [
        *encode_owner(context.owner),
        context.home,
        context.node,
        context.net,
        encode_error(context.failure),
        plain(context.results, f"what net {context.net} tells"),
        encode_error(context.cancelled),
        context.held,
    ]


def _decode_carried(content: object) -> TokenContext:
    match content:
        case [*job, bool(home), str(node), str(net), failure, dict(results), why, bool(held)]:
            owner = decode_owner(job)
            return TokenContext(owner, home, node, net, decode_error(failure), results, decode_error(why), held)
    raise ValueError(f"{str(content)[:200]} is not what a token carries")


def _data_fields(data: JobData | JobChange | None) -> object:
    if not isinstance(data, JobChange):
        return data
    named = {"memory": data.memory, "results": data.results, "progress": data.progress}
    return {name: value for name, value in named.items() if value is not None}


def _data_of(content: object) -> JobData | JobChange | None:
    match content:
        case None:
            return None
        case [dict(memory), dict(results), float(progress)]:
            return JobData(memory, results, progress)
    if isinstance(content, dict):
        changed, returned, now = content.get("memory"), content.get("results"), content.get("progress")
        if isinstance(changed, list | None) and isinstance(returned, list | None) and isinstance(now, float):
            return JobChange(changed, returned, now)
    raise ValueError(f"{str(content)[:200]} is not what a job holds")


def _reason(content: object) -> ImError:
    error = decode_error(content)
    if error is None:
        raise ValueError("it says no reason")
    return error


def encode_command(command: Command) -> list[object]:
    """Write a command.

    Raises:
        NetError: JSON cannot carry its arguments.
    """
    arguments = plain(command.arguments, f"the arguments of command {command.symbol}")
    fields: list[object] = [command.id, command.symbol, arguments]
    return [*fields, *(each for each in (command.priority, command.scope) if each)]


def decode_command(content: object) -> Command:
    """Read a command; priority and scope are present where the command has a value.

    Raises:
        ValueError: It is none.
    """
    match content:
        case [int(number), str(symbol), dict(arguments), int(priority), str(scope)]:
            return Command(number, symbol, arguments, priority, scope)
        case [int(number), str(symbol), dict(arguments), int(priority)]:
            return Command(number, symbol, arguments, priority)
        case [int(number), str(symbol), dict(arguments), str(scope)]:
            return Command(number, symbol, arguments, scope=scope)
        case [int(number), str(symbol), dict(arguments)]:
            return Command(number, symbol, arguments)
    raise ValueError(f"{str(content)[:200]} is no command")


def encode_request(request: Request) -> list[object]:
    """Write a request.

    Raises:
        NetError: JSON cannot carry its arguments.
    """
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


def decode_request(content: object) -> Request:
    """Read a request.

    Raises:
        ValueError: It is none.
    """
    match content:
        case [str(name), str(net), str(service), str(node), str(caller), str(by), command, dict(arguments)]:
            return Request(name, net, service, node, caller, by, decode_command(command), arguments)
    raise ValueError(f"{str(content)[:200]} is no request")


# The exchange.


def encode_exchange_entry(entry: ExchangeEntry) -> str:
    """Write an entry of an exchange.

    Raises:
        NetError: It has a part that JSON cannot carry.
    """
    match entry:
        case EventPosted(net, TokenArrived(place, count, None)):
            return _posted_token(net, place, count)
        case EventPosted(net, event):
            fields: list[object] = ["posted", net, encode_delivery(event)]
        case RequestAsked():
            fields = ["asked", *entry]
        case RequestAnswered(request_id):
            fields = ["answered", request_id]
        case RequestClosed(request_id):
            fields = ["closed", request_id]
        case RequestsRenamed(life):
            fields = ["renamed", life]
        case TokenKept(net, place):
            fields = ["undeliverable", net, place]
    return f'["exchange",{encode_json(fields)}]'


@functools.lru_cache(maxsize=4096)
def _posted_token(net: str, place: str, count: int) -> str:
    return f'["exchange",{encode_json(["posted", net, ["token", place, count]])}]'


def decode_exchange_entry(content: object) -> ExchangeEntry:
    """Read an entry of an exchange.

    Raises:
        ValueError: It is none.
        NetError: Likewise.
    """
    match content:
        case ["posted", str(net), delivery]:
            return EventPosted(net, decode_delivery(delivery))
        case ["asked", str(request_id), str(net), int(number), str(asked), str(node)]:
            return RequestAsked(request_id, net, number, asked, node)
        case ["answered", str(request_id)]:
            return RequestAnswered(request_id)
        case ["closed", str(request_id)]:
            return RequestClosed(request_id)
        case ["renamed", str(life)]:
            return RequestsRenamed(life)
        case ["undeliverable", str(net), str(place)]:
            return TokenKept(net, place)
    raise ValueError(f"{str(content)[:200]} is no entry of an exchange")


# The link.


def encode_link_entry(entry: LinkEntry) -> str:
    """Write an entry of a link."""
    if isinstance(entry, MessageTaken):  # the first two come with every message
        why = encode_json(entry.refusal) if entry.refusal else '""'
        return f'["link",["in",{_quoted(entry.node)},{entry.number},{why}]]'
    if isinstance(entry, MessageSent):
        return f'["link",["out",{_quoted(entry.node)},{entry.text}]]'
    match entry:
        case MessagesAcknowledged(node, floor):
            return f'["link",["acked",{_quoted(node)},{floor}]]'
        case MessageRefused(node, number):
            return f'["link",["refused",{_quoted(node)},{number}]]'
        case MessageVoided(node, number):
            return f'["link",["void",{_quoted(node)},{number}]]'
        case LifeBegun(node, epoch, journal):
            return f'["link",["begin",{_quoted(node)},{epoch},{int(journal)}]]'
        case NumbersSkipped(node, floor):
            return f'["link",["move",{_quoted(node)},{floor}]]'
        case EpochRaised(epoch):
            return f'["link",["epoch",{epoch}]]'


def decode_link_entry(content: object) -> LinkEntry:
    """Read an entry of a link.

    Raises:
        ValueError: It is none.
    """
    match content:
        case ["in", str(node), int(number), str(refusal)]:
            return MessageTaken(node, number, refusal)
        case ["out", str(node), [int(number), *fields]]:
            return MessageSent(node, number, numbered(number, decode_message(fields)))
        case ["acked", str(node), int(floor)]:
            return MessagesAcknowledged(node, floor)
        case ["refused", str(node), int(number)]:
            return MessageRefused(node, number)
        case ["void", str(node), int(number)]:
            return MessageVoided(node, number)
        case ["begin", str(node), int(epoch), int(journal)]:
            return LifeBegun(node, epoch, journal != 0)
        case ["move", str(node), int(floor)]:
            return NumbersSkipped(node, floor)
        case ["epoch", int(epoch)]:
            return EpochRaised(epoch)
    raise ValueError(f"{str(content)[:200]} is no entry of a link")
