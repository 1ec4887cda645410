"""The exchange of one process: carries tokens, requests and replies between its nets, and to and from others."""

from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError, LinkError, StateError
from im_pnt.errors import NetError, nearest
from im_pnt.events import Observer, RequestArrived, RequestCancelled, TokenArrived
from im_pnt.executive import Executive
from im_pnt.expand import input_place
from im_pnt.jobs import Activity, Command, Request
from im_pnt.net import RemotePlace, RequestAction
from im_pnt.remote import Kind, Message
from im_pnt.requests import RequestBook, Waiting


class Transport(Protocol):
    """Carries messages to other processes."""

    def node_of(self, net: str) -> str:
        """Returns the node that runs a net."""

    def send(self, node: str, message: Message) -> None:
        """Sends a message; it arrives once, some time."""

    def forget(self, request_id: str) -> None:
        """Stops repeating what was sent about a request."""


class Exchange:
    """Knows the nets of its process, and the requests under way.

    Args:
        node: Name of the process' node.
        epoch: Its incarnation.
        transport: To other processes; None: there are none.
        observer: Is told of what is dropped, and why.
    """

    def __init__(
        self, node: str, epoch: int, transport: Transport | None = None, observer: Observer | None = None
    ) -> None:
        self.nets: dict[str, Executive] = {}
        self.book = RequestBook(node, epoch)
        self._transport = transport
        self._observer = observer or Observer()
        self._in_work: dict[str, Request] = {}
        self._unwanted: set[str] = set()

    def add(self, executive: Executive) -> None:
        """Enters a net, in the place of one of the same name that is not busy.

        Raises:
            StateError: The one of the same name is busy.
        """
        name = executive.net.name
        if name in self.nets and self.nets[name].busy():
            raise StateError(
                f"net {name} is busy and cannot be replaced now; wait until its command has ended", net=name
            )
        self.nets[name] = executive

    # What the nets of this process send.

    def send_token(self, net: str, target: RemotePlace, count: int) -> None:
        """Sends tokens to a place of another net."""
        for _ in range(count):
            message = Message(Kind.TOKEN, target.net, target.place)
            if target.net in self.nets:
                self._dropped(self._deliver_token(message))
            elif self._transport is not None:
                self._transport.send(self._transport.node_of(target.net), message)
            else:
                self._dropped(f"no net {target.net} to give a token of net {net} to")

    def send_request(self, executive: Executive, activity: Activity, arguments: dict[str, object]) -> None:
        """Sends a request; its reply, or why there is none, ends the activity."""
        action = activity.action
        assert isinstance(action, RequestAction)
        local = action.net in self.nets
        node = "" if local or self._transport is None else self._transport.node_of(action.net)
        request_id = self.book.open(Waiting(executive, activity, action.net, node, monotonic()))
        activity.on_cancel.append(lambda: self._cancel_request(activity))
        job = activity.lineage.job
        command = job.command if job else Command()
        request = Request(
            request_id, action.net, action.service, "", activity.net, activity.transition, command, arguments
        )
        if local:
            refusal = self._deliver_request(request)
            if refusal:
                self.book.answer(request_id, NetError(refusal), {})
        elif self._transport is None:
            self.book.answer(request_id, LinkError(f"there is no net {action.net}{nearest(action.net, self.nets)}"), {})
        else:
            self._transport.send(node, _request_message(request))

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request of whatever process."""
        self._in_work.pop(request.id, None)
        if not request.caller_node:
            if not self.book.answer(request.id, error, results):
                self._dropped(
                    f"nobody waits for the reply to {request.caller_net}.{request.caller_transition} any more"
                )
        elif self._transport is not None:
            message = Message(Kind.REPLY, request.caller_net, "", request.id, error=error, payload={"results": results})
            self._transport.send(request.caller_node, message)

    def _cancel_request(self, activity: Activity) -> None:
        found = self.book.of_activity(activity)
        if found is None:
            return
        request_id, waiting = found
        if waiting.net in self.nets:
            self.nets[waiting.net].post(RequestCancelled(request_id, _cancelled_by(activity.net)))
        elif self._transport is not None:
            payload: dict[str, object] = {"cancel": True}
            message = Message(Kind.REQUEST, waiting.net, "", request_id, activity.net, payload=payload)
            self._transport.send(waiting.node, message)

    # What arrives from other processes.

    def receive(self, sender: str, message: Message) -> str:
        """Takes a message from another process; returns why it is refused, empty if it is not."""
        if message.kind is Kind.REPLY:
            results = message.payload.get("results")
            if not self.book.answer(message.request_id, message.error, results if isinstance(results, dict) else {}):
                self._dropped(f"nobody waits for reply {message.request_id} of {sender} any more")
            return ""
        if message.net not in self.nets:
            return f"there is no net {message.net} here{nearest(message.net, self.nets)}"
        if message.kind is Kind.TOKEN:
            return self._deliver_token(message)
        if message.payload.get("cancel") is True:
            if message.request_id in self._in_work:
                error = _cancelled_by(message.caller_net)
                self.nets[message.net].post(RequestCancelled(message.request_id, error))
            else:
                self._unwanted.add(message.request_id)
            return ""
        return self._deliver_request(_request_of(sender, message))

    def refused(self, message: Message, why: str) -> None:
        """Takes back a message that its receiver refused."""
        if message.kind is Kind.REQUEST and self.book.answer(message.request_id, NetError(why), {}):
            return
        self._dropped(f"{message.kind.name.lower()} for net {message.net} was refused: {why}")

    def node_lost(self, node: str, why: str) -> None:
        """Ends what waits for a node that is gone, and what is done for it."""
        for request_id in self.book.of_node(node):
            if self._transport is not None:
                self._transport.forget(request_id)
            self.book.answer(request_id, LinkError(why, node=node), {})
        for request in list(self._in_work.values()):
            if request.caller_node == node:
                del self._in_work[request.id]
                self.nets[request.net].post(RequestCancelled(request.id, LinkError(why, node=node)))

    def partners(self) -> frozenset[str]:
        """Returns the nodes that requests wait for, and those that wait for replies."""
        asked = {waiting.node for _, waiting in self.book.items() if waiting.node}
        return frozenset(asked | {request.caller_node for request in self._in_work.values() if request.caller_node})

    def tidy(self) -> None:
        """Drops the requests whose transitions have given up waiting; their servers were told when that happened."""
        for request_id, waiting in self.book.given_up():
            self._dropped(f"net {waiting.net} has not answered request {request_id} in time")

    def _deliver_token(self, message: Message) -> str:
        executive = self.nets[message.net]
        place = executive.net.places.get(message.place)
        if place is None:
            return f"net {message.net} has no place {message.place}{nearest(message.place, executive.net.places)}"
        if not place.remote or place.name.startswith("I."):
            return f"place {message.place} of net {message.net} is not open to other nets (remote: true)"
        executive.post(TokenArrived(message.place, 1))
        return ""

    def _deliver_request(self, request: Request) -> str:
        executive = self.nets[request.net]
        if request.service not in executive.net.services:
            hint = nearest(request.service, executive.net.services)
            return f"net {request.net} offers no service {request.service}{hint}"
        self._in_work[request.id] = request
        executive.post(RequestArrived(request))
        if request.id in self._unwanted:
            self._unwanted.discard(request.id)
            executive.post(RequestCancelled(request.id, _cancelled_by(request.caller_net)))
        return ""

    def _dropped(self, why: str) -> None:
        if why:
            self._observer.troubled("", why)


def _cancelled_by(net: str) -> ImError:
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)


def _request_message(request: Request) -> Message:
    payload: dict[str, object] = {
        "arguments": request.arguments,
        "symbol": request.command.symbol,
        "command_arguments": request.command.arguments,
    }
    return Message(
        Kind.REQUEST,
        request.net,
        input_place(request.service),
        request.id,
        request.caller_net,
        request.caller_transition,
        request.command.id,
        payload=payload,
    )


def _request_of(sender: str, message: Message) -> Request:
    def mapping(key: str) -> dict[str, object]:
        value = message.payload.get(key)
        return value if isinstance(value, dict) else {}

    command = Command(message.command_id, str(message.payload.get("symbol", "")), mapping("command_arguments"))
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
