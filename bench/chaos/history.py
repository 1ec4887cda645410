"""``python -m bench.chaos.history FILE``: what servers of a host did, from their own events, and a judgement of that.

Nets are not asked: goals and results are those of the action servers, puts and versions those of the object store.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from rclpy.parameter import Parameter
from service_msgs.msg import ServiceEventInfo

from im_core.files import read_text
from im_core.ros import qos
from im_core.ros.messages.interfaces import message_class
from im_core.ros.node import ManagedNode
from im_core.ros.run import main
from im_core.text.jsontext import JsonError, decode_json

_GOALS, _RESULTS = "/_action/send_goal/_service_event", "/_action/get_result/_service_event"
_PUTS = ("/dom/put/_service_event", "/dom/append/_service_event")
#: Of the dispatcher goals are of clients, and its host may be the one that fails.
_NOT_HERE = "/dispatcher/"
_LOOK_S = 1.0


class HistoryNode(ManagedNode):
    """Recorder of the events of servers: goals taken, results, puts acknowledged.

    Args:
        file: Gets a line for each.
    """

    def __init__(self, file: TextIO) -> None:
        super().__init__("history", parameter_overrides=[Parameter("standalone", value=True)])
        self._file = file
        self._heard: set[str] = set()
        self.create_timer(_LOOK_S, self._look, clock=self.steady_clock)

    def _look(self) -> None:
        """Listen to what servers began to tell since the last look."""
        for topic, (kind, *_) in self.get_topic_names_and_types():
            known = topic in self._heard or topic.startswith(_NOT_HERE)
            if known or not topic.endswith((_GOALS, _RESULTS, *_PUTS)):
                continue
            self._heard.add(topic)
            self.create_subscription(message_class(kind), topic, partial(self._note, topic), qos.SERVICE_EVENTS)

    def _note(self, topic: str, event: Any) -> None:
        told = event.info.event_type
        if topic.endswith(_GOALS) and told == ServiceEventInfo.REQUEST_RECEIVED:
            self._write("begun", bytes(event.request[0].goal_id.uuid).hex(), topic.removesuffix(_GOALS))
        elif topic.endswith(_RESULTS) and told == ServiceEventInfo.RESPONSE_SENT and event.response:
            self._write("ended", bytes(event.request[0].goal_id.uuid).hex(), event.response[0].status)
        elif topic in _PUTS and told == ServiceEventInfo.RESPONSE_SENT and event.response[0].success:
            self._write("put", event.response[0].object.name, event.response[0].object.version)

    def _write(self, *entry: object) -> None:
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()


def faults(entries: Iterable[tuple[str, str, object]], objects: Mapping[str, int]) -> Iterator[str]:
    """Yield what should not have happened, as sentences.

    Args:
        entries: In their order: ``begun`` with goal and action, ``ended`` with goal and status, ``put`` with object and
            version.
        objects: What the store has in the end: version by name.
    """
    begun: Counter[str] = Counter()
    ends: dict[str, set[str]] = {}
    acknowledged: dict[str, int] = {}
    for what, name, told in entries:
        if what == "begun":
            begun[name] += 1
        elif what == "ended":
            ends.setdefault(name, set()).add(str(told))
        else:
            acknowledged[name] = max(acknowledged.get(name, 0), int(str(told)))
    yield from (f"goal {goal} was begun {count} times" for goal, count in begun.items() if count > 1)
    yield from (f"goal {goal} ended as {', '.join(sorted(how))}" for goal, how in ends.items() if len(how) > 1)
    for name, version in acknowledged.items():
        if name in objects and objects[name] < version:
            yield f"version {version} of {name} was acknowledged, and the store has version {objects[name]}"


def read(file: Path) -> Iterator[tuple[str, str, object]]:
    """Yield the entries of a file; a line that its writer has not finished says nothing.

    Raises:
        FileError: It cannot be read.
    """
    for line in read_text(file).splitlines():
        with suppress(JsonError):
            match decode_json(line):
                case [str(what), str(name), told]:
                    yield what, name, told


if __name__ == "__main__":
    with Path(sys.argv[1]).open("a", encoding="utf-8") as lines:
        sys.exit(main(lambda: HistoryNode(lines), args=[]))
