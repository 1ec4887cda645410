"""The cell of a recording at any moment: robot, joints, frames, markers, images and spots."""

import threading
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from im_bag.reading import messages_of, topics_of
from im_core.errors import ImError
from im_pnt_analysis.recorded.firings import FIRINGS, MissionTime
from im_pnt_display.page import cell
from im_pnt_display.page.state import Change

ROBOT = "/robot_description"
_IMAGE, _SPOT = "/image_raw", "/spot"
_TYPES = {
    FIRINGS: "im_msgs/msg/Firing",
    ROBOT: "std_msgs/msg/String",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/markers": "visualization_msgs/msg/MarkerArray",
}
_ENDINGS = {_IMAGE: "sensor_msgs/msg/Image", _SPOT: "geometry_msgs/msg/PointStamped"}
#: Positions of joints that follow each other closer are left out [s].
_JOINTS_APART_S = 0.05


class RecordedCell:
    """Cell over a bag; the bag is read at the first look. Images stay in the bag.

    Args:
        bag: Folder of the bag, or a file of it.

    Raises:
        DataError: It cannot be read.
    """

    def __init__(self, bag: Path) -> None:
        self._bag, self._lock = bag, threading.Lock()
        self._topics = {topic: (kind,) for topic, kind in topics_of(bag).items() if kind == _type_of(topic)}
        self._history: dict[str, tuple[list[float], list[Any]]] | None = None

    @property
    def recorded(self) -> bool:
        """Whether the bag has a robot."""
        return ROBOT in self._topics

    def parts(self, at_s: float, since_s: float | None) -> list[Change]:
        """Return the parts of the cell at a time, as changes.

        Args:
            at_s: Testbed time since the first firing [s].
            since_s: Time at which the viewer knows the cell, only other parts are returned; None: at none.

        Raises:
            DataError: The bag cannot be read.
        """
        changes: list[Change] = []
        for part, (times, contents) in self._known().items():
            number = bisect_right(times, at_s)
            if since_s is None or number != bisect_right(times, since_s):
                content = contents[number - 1] if number else None
                changes.append({"kind": "cell", "part": part, "content": self._content(part, content)})
        return changes

    def _known(self) -> Mapping[str, tuple[list[float], list[Any]]]:
        """Return times [s] and contents of each part; one thread reads them, others wait."""
        with self._lock:
            if self._history is None:
                history: dict[str, tuple[list[float], list[Any]]] = {}
                for time_s, part, content in self._read():
                    times, contents = history.setdefault(part, ([], []))
                    if part != "joints" or not times or time_s - times[-1] >= _JOINTS_APART_S:
                        times.append(time_s)
                        contents.append(content)
                self._history = history
            return self._history

    def _read(self) -> Iterator[tuple[float, str, Any]]:
        """Yield time [s], part and content of each message; of an image the time of recording [ns]."""
        time: MissionTime | None = None
        at_s = 0.0
        for message in messages_of(self._bag, self._topics):
            if message.topic == FIRINGS:
                time = time or MissionTime(message.content)
                at_s = max(at_s, time.of(message.content))
                continue
            if time is not None and (stamp_s := _stamp_of(message.content)):
                at_s = max(at_s, stamp_s - time.zero_s)
            try:
                for part, content in _parts_of(message.topic, message.content, message.logged_ns):
                    yield at_s, part, content
            except ImError:  # as on the page of a machine: what cannot be shown is passed over
                continue

    def _content(self, part: str, content: Any) -> object:
        if content is None or not part.startswith("image/"):
            return content
        camera = part.removeprefix("image/")
        topic = f"/{camera}{_IMAGE}"
        for message in messages_of(self._bag, {topic: self._topics[topic]}, logged_ns=content):
            return cell.png(camera, message.content)[1]
        return None


def _type_of(topic: str) -> str | None:
    endings = (kind for ending, kind in _ENDINGS.items() if topic.endswith(ending))
    return _TYPES.get(topic) or next(endings, None)


def _stamp_of(content: Any) -> float:
    """Return the stamp of a message [s]; 0 where it has none."""
    stamp = getattr(getattr(content, "header", None), "stamp", None)
    return stamp.sec + stamp.nanosec * 1e-9 if stamp is not None else 0.0


def _parts_of(topic: str, content: Any, logged_ns: int) -> Iterable[tuple[str, Any]]:
    readers: Mapping[str, Any] = {
        ROBOT: lambda: [("robot", content.data)],
        "/joint_states": lambda: [cell.joints(content)],
        "/tf_static": lambda: cell.frames(content),
        "/markers": lambda: cell.markers(content),
    }
    if topic in readers:
        parts: Iterable[tuple[str, Any]] = readers[topic]()
        return parts
    if topic.endswith(_SPOT):
        return [cell.spot(topic.removesuffix(_SPOT).strip("/"), content)]
    return [(f"image/{topic.removesuffix(_IMAGE).strip('/')}", logged_ns)]
