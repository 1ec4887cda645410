"""Requests, tokens of jobs and the updates as messages between processes, and back."""

from collections.abc import Mapping

from im_pnt.errors import decode_error, encode_error
from im_pnt.execution.events import JobUpdate, JobUpdateArrived
from im_pnt.execution.jobs import Command, JobKey, Owner, Request, TokenContext
from im_pnt.model.expand import input_place
from im_pnt.model.net import RemotePlace
from im_pnt_node.distributed.packets import Message, MessageKind


def request_message(request: Request, held: bool = False) -> Message:
    """Return the message with a request for another process, and whether nothing is begun for the request there."""
    payload: dict[str, object] = {
        "arguments": request.arguments,
        "symbol": request.command.symbol,
        "command_arguments": request.command.arguments,
    }
    if request.command.scope:
        payload["scope"] = request.command.scope
    if held:
        payload["held"] = True
    return Message(
        MessageKind.REQUEST,
        request.net,
        input_place(request.service),
        request.id,
        request.caller_net,
        request.caller_transition,
        request.command.id,
        payload=payload,
    )


def request_of(sender: str, message: Message) -> Request:
    """Return the request in a message."""

    def mapping(key: str) -> dict[str, object]:
        value = message.payload.get(key)
        return value if isinstance(value, dict) else {}

    def text(key: str) -> str:
        value = message.payload.get(key)
        return value if isinstance(value, str) else ""

    command = Command(message.command_id, text("symbol"), mapping("command_arguments"), scope=text("scope"))
    return Request(
        message.request_id,
        message.net,
        message.place.removeprefix("I."),
        sender,
        message.caller_net,
        message.caller_transition,
        command,
        mapping("arguments"),
    )


def cancel_message(request_id: str, net: str, caller_net: str) -> Message:
    """Return the message of an unwanted request."""
    payload: Mapping[str, object] = {"cancel": True}
    return Message(MessageKind.REQUEST, net, "", request_id, caller_net, payload=payload)


def hold_message(request_id: str, net: str, caller_net: str, held: bool) -> Message:
    """Return the message telling a process to begin nothing for a request, or to go on."""
    return Message(MessageKind.REQUEST, net, "", request_id, caller_net, payload={"held": held})


def with_hold(message: Message, held: bool) -> Message:
    """Return a not yet taken message, adapted to the job's pause or release.

    What is done for nobody is as it was: nobody could resume it.
    """
    payload = message.payload
    if message.kind is MessageKind.TIDING and payload.get("tiding") in (JobUpdate.HELD, JobUpdate.RELEASED):
        return message._replace(payload={**payload, "tiding": (JobUpdate.HELD if held else JobUpdate.RELEASED).value})
    of_somebody = message.kind in (MessageKind.REQUEST, MessageKind.TOKEN) and message.command_id != 0
    if of_somebody or "held" in payload:
        return message._replace(payload={**payload, "held": held})
    return message


def token_of_job(target: RemotePlace, context: TokenContext) -> Message:
    """Return the message of a job's token to another process."""
    owner = context.owner
    payload: dict[str, object] = {
        "job": [*owner.key],
        "symbol": owner.symbol,
        "command": [owner.command.symbol, owner.command.arguments, owner.command.priority, owner.command.scope],
        "arguments": owner.arguments,
        "results": context.results,
        "cancelled": encode_error(context.cancelled),
        "held": context.held,
    }
    return Message(
        MessageKind.TOKEN,
        target.net,
        target.place,
        caller_net=context.net,
        command_id=owner.command.id,
        error=context.failure,
        payload=payload,
    )


def carried_by(sender: str, message: Message) -> TokenContext | None:
    """Return the context of a token from another process, None without a job; the home is not told.

    Raises:
        ValueError: It makes no sense.
    """
    if not message.payload:
        return None
    match message.payload:
        case {
            "job": [str(process), str(net), int(number)],
            "symbol": str(symbol),
            "command": [str(name), dict(given), int(priority), str(scope)],
            "arguments": dict(arguments),
            "results": dict(results),
            "cancelled": cancelled,
            "held": bool(held),
        }:
            command = Command(message.command_id, name, given, priority, scope)
            owner = Owner(JobKey(process, net, number), symbol, command, arguments)
            why = decode_error(cancelled)
            return TokenContext(owner, False, sender, message.caller_net, message.error, results, why, held)
    raise ValueError(f"{str(message.payload)[:200]} does not tell whose a token is")


def tiding_message(to: str, told: JobUpdateArrived) -> Message:
    """Return the message of a job's update to a net of another process."""
    payload: dict[str, object] = {"job": [*told.key], "tiding": told.update.value, "results": told.results}
    return Message(MessageKind.TIDING, to, "", caller_net=told.net, error=told.error, payload=payload)


def tiding_of(message: Message) -> JobUpdateArrived:
    """Return the update of a job in a message; the home is not told.

    Raises:
        ValueError: It makes no sense.
    """
    match message.payload:
        case {"job": [str(process), str(net), int(number)], "tiding": str(update), "results": dict(results)}:
            key = JobKey(process, net, number)
            return JobUpdateArrived(key, False, JobUpdate(update), message.caller_net, message.error, results)
    raise ValueError(f"{str(message.payload)[:200]} tells nothing of a job")
