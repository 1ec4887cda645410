"""``pnt mission``: run the nets of a recorded mission again, and name the first difference."""

import argparse
import math
import re
import sys
from base64 import b64decode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, suppress
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

from rclpy.serialization import serialize_message

from im_bag.command_line import parsed
from im_bag.definitions import changed_types
from im_bag.reading import messages_of, open_bag, topics_of
from im_core.clock import monotonic
from im_core.errors import DataError, ImError
from im_core.options import seconds
from im_core.ros.messages.interfaces import decoded, interface_class, type_name
from im_core.ros.messages.message_fields import filled
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Activity
from im_pnt.execution.runner import Ask, Perform
from im_pnt.execution.values import Objects
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.groups import nets_by_name
from im_pnt.model.net import Net
from im_pnt.netfile import load_net
from im_pnt_node.distributed.codec import ANSWER
from im_pnt_node.rerun.difference import Difference, first_difference
from im_pnt_node.rerun.rerun import TOLERANCE_S, Compared, NodeRerun
from im_pnt_node.rerun.script import Script, ScriptHost
from im_pnt_node.rerun.stream import NodeStream, streams_of
from im_pnt_node.ros.execution.actions import answer_key, fields_of, handled, require_success, sent_key
from im_pnt_node.ros.execution.goals import chosen, result_of
from im_pnt_node.ros.messages import packed_message
from im_pnt_node.ros.objects.objects import DomObjects
from im_pnt_node.ros.reporting.mission import TOPIC

_DESCRIPTION = """Runs the nets of a recorded mission again on the recorded answers: no robot, no camera, no node.
Commands, requests, answers, data objects and what guards look at come from the bag; the nets, their guards and their
functions are those of this installation. Compares firing by firing, and tells the first difference with both sides;
a firing whose delay is over later than in the bag, by more than --tolerance, is one.

  scripts/replay.sh bags/demo --mission                       does this installation still do the same?
  scripts/replay.sh bags/demo --mission --nets my_net.yaml    with another net in the place of the one of its name
  scripts/replay.sh bags/demo --mission --bag-nets            with the nets as they were recorded

Exit code: 0 equal, 1 it differs, 2 the bag cannot be run again, or an option is wrong."""

EQUAL, DIFFERS, BAD_INPUT = 0, 1, 2
_CHANGED = "{} is another message here than in the bag, which was recorded before it changed: record it anew"
_TYPE = re.compile(r'"(\w+/(?:msg|srv|action)/\w+)"')
INSTALLED = ("im_dispatcher", "im_coordinators")
TOLD_S = 2.0
MessageT = TypeVar("MessageT")


class _ChangedMessage(BaseException):
    """Signal of a recorded message of another type than here; no failure of an action."""


class RosMessages:
    """Messages and the JSON data (:class:`im_pnt_node.rerun.script.Messages`)."""

    def packed(self, message: object) -> list[str]:
        """Return the data of a message."""
        return packed_message(message)

    def unpacked(self, data: str, kind: type[MessageT]) -> MessageT:
        """Return a message."""
        message: MessageT = _unpacked(data, kind)
        return message

    def difference(self, recorded: object, now: object) -> str:
        """Return the first difference of two messages; padding bytes are ignored."""
        match recorded, now:
            case [str(then_type), str(then)], [str(now_type), str(again)] if then_type == now_type and "/" in now_type:
                kind = interface_of(then_type)
                before, after = (_tree(_unpacked(data, kind)) for data in (then, again))
                return first_difference(before, after)
        return first_difference(recorded, now)


def _unpacked(data: str, kind: Any) -> Any:
    """Return the message of CDR in base64.

    Raises:
        _ChangedMessage: It has not the length of such a message: its type has changed since it was recorded.
    """
    there, here = b64decode(data), b""
    with suppress(DataError):
        message = decoded(there, kind)
        here = serialize_message(message)
    if len(here) != len(there):
        raise _ChangedMessage(_CHANGED.format(type_name(kind)))
    return message


def _tree(value: Any) -> object:
    """Return a message as comparable data; all NaN are equal."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: _tree(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, float) and math.isnan(value):
        return "nan"
    if isinstance(value, bool | int | float | str | bytes):
        return value
    return [_tree(each) for each in value]


def interface_of(name: str) -> Any:
    """Return the class of a message, or of a part of a service or action: ``im_msgs/srv/SetLight_Request``."""
    for part in ("_Request", "_Response", "_Goal", "_Result"):
        if "/msg/" not in name and name.endswith(part):
            return getattr(interface_class(name.removesuffix(part)), part[1:])
    return interface_class(name)


class RosWorld:
    """Repetition of actions on other tasks (:class:`im_pnt_node.rerun.rerun.ActionsAgain`)."""

    def performers(
        self, script: Script, functions: Functions, keep: Callable[[Activity], None]
    ) -> tuple[Mapping[type, Perform], Mapping[type, Ask]]:
        """Return the performer of each kind of action, and the question after a doubt."""

        async def sent(activity: Activity, action: Any, context: ActionContext, message: Any) -> None:
            filled(message, await fields_of(functions, action, context), str(action))
            keep(activity)
            script.sent(sent_key(activity), packed_message(message))

        async def service(activity: Activity, context: ActionContext) -> dict[str, object]:
            action = activity.action
            assert isinstance(action, ServiceAction)
            interface = interface_class(action.type)
            await sent(activity, action, context, interface.Request())
            _, data = await script.wait(answer_key(activity))
            response = _unpacked(data, interface.Response)
            require_success(response, str(action))
            return await handled(functions, action, context, response)

        async def goal(activity: Activity, context: ActionContext) -> dict[str, object]:
            action = chosen(activity, context)
            interface = interface_class(action.type)
            await sent(activity, action, context, interface.Goal())
            status, _, data = await script.wait(answer_key(activity))
            result = result_of(action, int(status), _unpacked(data, interface.Result))
            return await handled(functions, action, context, result)

        async def topic(activity: Activity, context: ActionContext) -> dict[str, object]:
            action = activity.action
            assert isinstance(action, TopicAction)
            await sent(activity, action, context, interface_class(action.type)())
            return {}

        async def await_message(activity: Activity, context: ActionContext) -> dict[str, object]:
            action = activity.action
            assert isinstance(action, AwaitAction)
            _, data = await script.wait(answer_key(activity))
            return await handled(functions, action, context, _unpacked(data, interface_class(action.type)))

        async def asked(activity: Activity, _: ActionContext) -> Answer:
            return ANSWER.decode(await script.wait(["asked", activity.net, activity.number]))

        def waited(activity: Activity, _: ActionContext) -> Answer:
            return Answer(Outcome.FAILED, activity.doubt, asked="nobody: it only waited")

        performed = {ServiceAction: service, GoalAction: goal, TopicAction: topic, AwaitAction: await_message}
        return performed, {GoalAction: asked, AwaitAction: waited}

    def objects(self, host: ScriptHost, spawn: Callable[..., None], known: Callable[[], None]) -> Objects:
        """Return the data objects of expressions."""
        return DomObjects(host.dom, spawn, known)

    def heard(self, kind: str, data: str) -> object:
        """Return a recorded message."""
        return _unpacked(data, interface_of(kind))


def told_in(bag: Path) -> list[NodeStream]:
    """Read the recorded events of the nodes of a mission.

    Args:
        bag: Folder of the bag, or a file of it.

    Raises:
        DataError: The bag cannot be read, or does not hold what is needed.
    """
    if TOPIC not in topics_of(bag):
        raise DataError(
            f"{bag}: there is nothing on {TOPIC} in it, from which nets could be run again: it is no recording of a "
            "machine of ours, or an old one, or its recorder did not take that topic"
        )
    streams = streams_of(_texts(bag))
    if not streams:
        raise DataError(f"{bag}: no node has told anything on {TOPIC}")
    return streams


def _texts(bag: Path) -> Iterator[str]:
    for message in messages_of(bag, {TOPIC: ("std_msgs/msg/String",)}):
        yield str(message.content.data)


def installed_nets() -> dict[str, Net]:
    """Return the shipped nets, by name."""
    nets = {}
    for package in INSTALLED:
        for file in sorted((Path(str(files(package))) / "nets").glob("*.yaml")):
            net = load_net(file)
            nets[net.name] = net
    return nets


def _changed_message(bag: Path) -> str:
    """Return a sentence about a recorded message with another definition in the bag than here; empty without one."""
    told = set(_TYPE.findall("".join(_texts(bag))))
    with closing(open_bag(bag)) as reader:
        for each in reader.connections:
            with suppress(DataError):  # a type of others, which is not known here
                for name in told.intersection(changed_types(each.msgtype, each.msgdef)):
                    return _CHANGED.format(name)
    return ""


def rerun(
    bag: Path,
    streams: Sequence[NodeStream],
    nets: Mapping[str, Net],
    told: Callable[[str], None] = lambda _: None,
    tolerance: float = TOLERANCE_S,
) -> Compared:
    """Run the nets of a bag again.

    Args:
        bag: Folder of the bag, or a file of it.
        streams: What is told in it.
        nets: Nets that take the places of those in the bag, by name.
        told: Is told how far it is.
        tolerance: Time by which a delay may be over later than in the bag [s].

    Returns:
        What was compared: all was equal.

    Raises:
        Difference: The first one.
        DataError: The bag does not hold what is needed.
    """
    whole, began = Compared(set(), 0, 0, set()), monotonic()
    for rank, stream in enumerate(streams, 1):
        if monotonic() - began > TOLD_S:
            told(f"{rank} of {len(streams)} nodes: {stream.node}")
        try:
            part = NodeRerun(stream, RosWorld(), RosMessages(), nets, tolerance).run()
        except _ChangedMessage as changed:
            raise DataError(f"{bag}: {changed}") from changed
        whole.nets |= part.nets
        whole.changed |= part.changed
        whole.firings += part.firings
        whole.inputs += part.inputs
    return whole


def main(words: Sequence[str] | None = None, program: str = "mission") -> int:
    """Run the command.

    Args:
        words: Command line without the program's name; None: that of the process.
        program: What it is called.

    Returns:
        Exit code.
    """
    parser = argparse.ArgumentParser(
        program, description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="folder of the bag, or a file of it")
    parser.add_argument("--nets", nargs="+", default=[], metavar="FILE", help="nets in the places of their namesakes")
    parser.add_argument("--bag-nets", action="store_true", help="the nets as recorded, not those that are installed")
    parser.add_argument(
        "--tolerance",
        type=seconds,
        default=TOLERANCE_S,
        metavar="S",
        help="time by which a delay may be over later than in the bag [s] (%(default)g)",
    )
    options = parsed(parser, words)
    try:
        streams = told_in(options.bag)  # before the nets are read: it may be no such bag
        nets = {} if options.bag_nets else installed_nets()
        given = nets_by_name(map(load_net, options.nets))
        nets |= given
        said = partial(print, f"{program}:", file=sys.stderr)
        found = rerun(options.bag, streams, nets, said, options.tolerance)
        if unknown := sorted(given.keys() - found.nets):
            raise DataError(f"net {unknown[0]} is not in the bag; it has {', '.join(sorted(found.nets))}")
    except Difference as difference:
        if not (changed := _changed_message(options.bag)):
            print(f"{program}: {difference}")
            return DIFFERS
        print(f"{program}: {changed}", file=sys.stderr)
        return BAD_INPUT
    except ImError as error:
        print(f"{program}: {error.message}", file=sys.stderr)
        return BAD_INPUT
    print(f"{program}: equal: {len(found.nets)} nets, {found.firings} firings on {found.inputs} inputs")
    for name in sorted(found.changed):
        print(f"{program}: net {name} is another one than in the bag, and has done the same")
    return EQUAL


if __name__ == "__main__":
    sys.exit(main())
