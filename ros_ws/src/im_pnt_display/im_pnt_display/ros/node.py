"""``pnt_display``: shows the machine on a web page: nets, commands and the cell."""

import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any
from urllib.parse import parse_qs, urlsplit

from pydantic import BaseModel
from rclpy.client import Client
from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core.errors import ImError, NotFoundError, StateError
from im_core.files import read_text, write_whole
from im_core.names import display_file
from im_core.ros import qos
from im_core.ros.calls import call
from im_core.ros.latest import Latest
from im_core.ros.node import ManagedNode
from im_core.ros.run import main as run_main
from im_core.text.bounded_json import read_json
from im_msgs.msg import Firing, Marking, McsState, NetDescription, NetRefusal
from im_msgs.srv import ControlNet, GetObject, NetValues
from im_pnt_display.page import messages
from im_pnt_display.page.cell import Part
from im_pnt_display.page.descriptions import NetDescriptions
from im_pnt_display.page.server import DisplayServer
from im_pnt_display.page.viewers import VALUES
from im_pnt_display.ros.cell import CellTopics
from im_pnt_display.ros.diagnostics import DiagnosticsTopics
from im_pnt_display.ros.dispatcher import ANSWER_S, DispatcherClient

#: /mcs repeats its state twice a second; after this silence what it said last is stale [s], and how often that is seen.
MCS_SILENCE_S, MCS_LOOK_S = 3.0, 1.0


#: Data objects that are shown of a place, and characters of each.
MOST_OBJECTS, LONGEST_OBJECT = 5, 2000


class _Breakpoints(BaseModel):
    node: str
    breakpoints: dict[str, list[str]]


class DisplayNode(ManagedNode):
    """ROS shell of :class:`im_pnt_display.page.server.DisplayServer`; translates messages, decides nothing."""

    def __init__(self, *, parameter_overrides: list[Parameter] | None = None) -> None:
        super().__init__("pnt_display", parameter_overrides=parameter_overrides)
        declare = self.declared.declare
        host = declare(
            "host", "127.0.0.1", "address that the page is served on, and answers to besides localhost; 0.0.0.0: all"
        )
        port = declare("port", 8080, "TCP port of the page, the next free one if in use; 0: any", span=(0, 65535))
        control = declare(
            "control", False, "whether viewers with the token may operate the machine; if not, they only look"
        )
        self.server = DisplayServer(
            host,
            port,
            self._wanted,
            apart=True,
            audience=self._count_viewers,
            token=_token_of_former() if control else "",
            operable=control,
        )
        self._mcs: Latest[McsState] | None = None
        self._drawing = ThreadPoolExecutor(1, "drawing")  # a net of 1,000 places takes more than a second
        self._undrawn: dict[tuple[str, ...], Callable[[], None]] = {}
        self._undrawn_lock = threading.Lock()
        self._descriptions = NetDescriptions()
        self._askers: dict[str, Client] = {}
        self._object = self.create_client(GetObject, "/dom/get")
        self._cell = CellTopics(self, self._show_cell)
        self._dispatcher = DispatcherClient(self, self._show_commands)
        self._diagnostics = DiagnosticsTopics(
            self,
            partial(self._show_commands, "diagnostics"),
            lambda lines: self._tell("log", lines=lines),
        )

    def phase_configure(self) -> None:
        """Open the page and follow the nets.

        Raises:
            LinkError: No port is free.
        """
        self.server.start()
        try:
            write_whole(display_file(), self.server.address + "\n", own=True)
        except ImError as error:  # other programs do not find the page by that file; it is served all the same
            self.get_logger().error(f"the address of the page is in no file: {error.message}")
        self.create_subscription(NetDescription, "/pnt/nets", self._describe, qos.LATCHED_NETS)
        self.create_subscription(Marking, "/pnt/markings", self._mark, qos.LATCHED_NETS)
        self.create_subscription(Firing, "/pnt/firings", self._fire, qos.EVENTS)
        self.create_subscription(String, "/pnt/breakpoints", self._show_breakpoints, qos.LATCHED_MANY)
        self.create_subscription(NetRefusal, "/pnt/refusals", self._refuse, qos.LATCHED_MANY)
        self._mcs = Latest(self, McsState, "/mcs/state", qos.LATCHED, MCS_SILENCE_S, self._show_mcs)
        self.create_timer(MCS_LOOK_S, self._show_mcs, clock=self.steady_clock)
        self.get_logger().info(f"nets are shown at {self.server.url}")

    def phase_shutdown(self) -> None:
        """Close the page."""
        self._drawing.shutdown(wait=False, cancel_futures=True)
        self.server.stop()
        with suppress(OSError):
            display_file().unlink(missing_ok=True)

    def _tell(self, kind: str, **content: object) -> None:
        self.server.show({"kind": kind, **content})

    def _show_mcs(self) -> None:
        """Show the last state of MCS, and whether the state is still current."""
        if self._mcs is None or (said := self._mcs.message) is None:
            return
        groups = {group.group: group.state for group in said.groups if group.reserved}
        self._tell(
            "mcs",
            state=said.state,
            reason=said.reason,
            power=said.power,
            brakes=said.brakes,
            groups=groups,
            stopped={group.group: group.owner for group in said.groups if group.protective_stop},
            protective_stop=said.protective_stop,
            stale=self._mcs.stale,
        )

    def _describe(self, message: NetDescription) -> None:
        work = self._draw_net if message.json else self._forget_net
        self._draw(("net", message.net, message.node), partial(work, message))

    def _refuse(self, message: NetRefusal) -> None:
        self._draw(("refusal", message.net), partial(self._draw_refusal, message))

    def _draw(self, key: tuple[str, ...], work: Callable[[], None]) -> None:
        """Draw something in the drawing thread, last in the queue, in the place of a waiting job of the same key."""
        with self._undrawn_lock:
            waited = self._undrawn.pop(key, None) is not None
            self._undrawn[key] = work
        if not waited:
            with suppress(RuntimeError):  # the display has closed; nothing more is drawn
                self._drawing.submit(self._draw_next)

    def _draw_next(self) -> None:
        with self._undrawn_lock:
            work = self._undrawn.pop(next(iter(self._undrawn)))
        work()

    def _draw_net(self, message: NetDescription) -> None:
        with self._warning(f"the description of net {message.net}"):
            content = messages.described_net(message.net, message.json, message.node)
            self._descriptions.add(message.net, message.node, content)
            self._tell("net", node=message.node, **content)

    def _forget_net(self, message: NetDescription) -> None:
        if not self._descriptions.withdraw(message.net, message.node):
            return
        try:
            node, content = self._descriptions.newest(message.net)
        except NotFoundError:
            self._tell("gone", net=message.net)
        else:  # another node runs it
            self._tell("net", node=node, **content)

    def _draw_refusal(self, message: NetRefusal) -> None:
        with self._warning(f"the refusal of net {message.net}"):
            counterexample = messages.counterexample(message.json)
            self._tell("refusal", net=message.net, message=message.message, counterexample=counterexample)

    def _mark(self, message: Marking) -> None:
        with self._warning(f"the marking of net {message.net}"):
            self._tell(
                "marking",
                net=message.net,
                tokens=messages.token_counts(message.places, message.tokens),
                active=list(message.active),
                cancelling=list(message.cancelling),
                in_doubt=list(message.in_doubt),
                sequence=int(message.sequence),
                mode=message.mode,
                paused=message.paused,
                proposed=list(message.proposed),
            )

    def _show_breakpoints(self, message: String) -> None:
        with self._warning("a message of /pnt/breakpoints"):
            told = read_json(_Breakpoints, message.data, "breakpoints")
            self._tell("breakpoints", node=told.node, breakpoints=told.breakpoints)

    def _fire(self, message: Firing) -> None:
        with self._warning(f"a firing of net {message.net}"):
            at_s = message.stamp.sec + message.stamp.nanosec * 1e-9
            self._tell("firing", **messages.firing_content(at_s, message))

    @contextmanager
    def _warning(self, what: str) -> Iterator[None]:
        """Write a warning to the log where a message cannot be shown."""
        try:
            yield
        except Exception as error:  # whatever arrives leaves a sentence, and the display goes on
            why = error.message if isinstance(error, ImError) else repr(error)
            self.get_logger().warning(f"{what} cannot be shown: {why}")

    def _show_commands(self, part: str, content: object) -> None:
        self._tell("commands", part=part, content=content)

    def _show_cell(self, topic: str, read: Callable[[], Iterable[Part]]) -> None:
        with self._warning(f"a message of {topic}"):
            for part, content in read():
                self._tell("cell", part=part, content=content)

    # What viewers ask for; it comes in the server's thread.

    def _count_viewers(self, viewers: int, of_cell: int) -> None:
        self.spawn(self._attend(viewers > 0, of_cell > 0))

    async def _attend(self, viewed: bool, cell_viewed: bool) -> None:
        """Follow the viewed parts of the machine, and nothing else."""
        self._dispatcher.follow(viewed)
        self._diagnostics.follow(viewed)
        self._cell.follow(cell_viewed)

    def _wanted(self, wanted: Mapping[str, str]) -> None:
        self.spawn(self._operate(wanted["net"], wanted["request"], wanted["argument"]))

    async def _operate(self, net: str, request: str, argument: str) -> None:
        try:
            if not net:
                done = await self._dispatcher.do(request, argument)
                self._tell("answer", net=net, success=True, message=done)
                return
            if request == VALUES:
                found = await self._find_values(net, argument)
                self._tell("values", net=net, part=argument, content=found)
                return
            asked = ControlNet.Request(net=net, request=request, argument=argument)
            answer = await call(
                self, self._asker(net, ControlNet, "control_net"), asked, ANSWER_S, f"{request} of net {net}"
            )
        except ImError as error:
            self._tell("answer", net=net, success=False, message=error.message)
        else:
            self._tell("answer", net=net, success=answer.success, message=answer.message)

    async def _find_values(self, net: str, part: str) -> dict[str, object]:
        """Return the values behind a part of a net, with its data objects as JSON, long ones cut.

        Raises:
            ImError: There is no such part, or nobody answered.
        """
        asked = NetValues.Request(net=net, part=part)
        answer = await call(self, self._asker(net, NetValues, "net_values"), asked, ANSWER_S, f"values of net {net}")
        if not answer.success:
            raise StateError(answer.message)
        found = read_json(dict[str, Any], answer.json, f"the values of net {net}")
        objects = {}
        for name in found.pop("objects", [])[:MOST_OBJECTS]:
            wanted = GetObject.Request(name=name, as_json=True)
            told = await call(self, self._object, wanted, ANSWER_S, f"data object {name} for the page")
            objects[name] = told.json[:LONGEST_OBJECT] if told.success else told.status.message
        return {**found, "objects": objects}

    def _asker(self, net: str, kind: type, service: str) -> Client:
        """Return the client of a service of the node that runs a net.

        Raises:
            NotFoundError: There is no such net.
        """
        node, _ = self._descriptions.newest(net)
        name = f"{node}/{service}"
        if name not in self._askers:
            self._askers[name] = self.create_client(kind, name)
        return self._askers[name]


def _token_of_former() -> str:
    """Return the token of a display of this run that was killed: its viewers go on; empty if there is none."""
    with suppress(ImError, OSError):
        return parse_qs(urlsplit(read_text(display_file()).strip()).query).get("token", [""])[0]
    return ""


def main() -> int:
    """Run the node ``/pnt_display``."""
    return run_main(DisplayNode)


if __name__ == "__main__":
    sys.exit(main())
