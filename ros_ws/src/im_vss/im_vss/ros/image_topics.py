"""Frame source of image topics: cameras with a ROS driver of any kind."""

import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError
from rclpy.client import Client
from sensor_msgs.msg import CompressedImage, Image
from std_srvs.srv import SetBool

from im_calibration.recorded.image_message import grey_image
from im_calibration.recorded.stamps import stamp_of
from im_cell.frames import Exposed, Frame, FrameSet, FrameSource, FrameSourceSetup, SnapOrder, nobody
from im_cell.sensor import SensorControls
from im_core import clock
from im_core.config import Model, faults
from im_core.errors import ConfigError, DataError, StateError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.messages.interfaces import decoded

_COMPRESSED = "/compressed"
"""End of topics of ``CompressedImage``, as image_transport names them."""
_ONE_CLOCK_NS = 5_000_000_000
"""A camera whose stamps are farther from this computer's time has a clock of its own."""


class TopicSettings(Model):
    """Settings of the source.

    Attributes:
        topics: Topic of each camera.
        light: Service ``std_srvs/SetBool`` that switches the light; empty: there is none.
    """

    topics: dict[str, str]
    light: str = ""


class ImageTopics(FrameSource):
    """Takes the first image of each camera's topic that is exposed after an order.

    Exposure times and gains are those of the drivers. A light is switched by a service.

    Args:
        setup: Cameras and settings, see :class:`TopicSettings`.

    Raises:
        ConfigError: The settings are wrong, or a camera has no topic.
    """

    def __init__(self, setup: FrameSourceSetup) -> None:
        try:
            self._settings = TopicSettings.model_validate(setup.settings)
        except ValidationError as error:
            first = faults(error, TopicSettings)[0]
            raise ConfigError(f"frame_source.settings.{first.field}: {first.sentence}", field=first.field) from error
        if lacking := [name for name in setup.cameras if name not in self._settings.topics]:
            raise ConfigError(f"frame_source.settings.topics: has no topic of {', '.join(lacking)}")
        self._sizes = {name: setup.cell.cameras[name].intrinsics for name in setup.cameras}
        self._exposure_s = setup.nominal_exposure_s
        self._topics = TopicImages(setup.node, {name: self._settings.topics[name] for name in setup.cameras})
        self._light = setup.node.create_client(SetBool, self._settings.light) if self._settings.light else None

    def start(self) -> None:
        """Do nothing: images are awaited with each order."""

    def wait_ready(self) -> None:
        """Return at once: the first order says which camera is missing."""

    def revive(self) -> str:
        """Return the empty text: drivers are not restarted from here."""
        return ""

    def close(self) -> None:
        """Stop listening."""
        self._topics.close()

    def take_frames(self, order: SnapOrder, exposed: Exposed = nobody) -> FrameSet:
        """Await an image of each camera for each frame of an order.

        Raises:
            StateError: Light, laser or sensors would have to be other than they can be made.
            WaitTimeoutError: A camera sends no image, or nothing switches the light.
            DataError: An image is of another size or of an unknown encoding.
        """
        if len(set(order.blank_laser)) > 1:
            raise StateError("the laser cannot be switched off for some images: cameras of topics do not strobe it")
        light = self._light
        if any(order.blank_light) and light is None:
            raise StateError("the light cannot be switched for an image: give the service that switches it (--light)")
        if changed := [name for name, each in order.controls.items() if each != SensorControls()]:
            raise StateError(f"gain and noise of {', '.join(changed)} are those of its driver")
        begin = clock.monotonic()
        frames: dict[str, list[Frame]] = {name: [] for name in order.cameras}
        for blank in order.blank_light:
            if light is not None and any(order.blank_light):
                self._switch(light, not blank, order.timeout_s)
            until = self._topics.counts()
            deadline = clock.monotonic() + order.timeout_s
            for name in order.cameras:
                message = self._topics.after(name, until[name], deadline, order.timeout_s)
                frames[name].append(Frame(name, self._pixels(name, message), stamp_of(message.header), blank))
        exposed(tuple(max(each[k].stamp_ns for each in frames.values()) for k in range(len(order.blank_light))))
        taken = {name: tuple(each) for name, each in frames.items()}
        return FrameSet(taken, {"expose_s": clock.monotonic() - begin}, self._exposure_s)

    def _switch(self, light: Client, on: bool, timeout_s: float) -> None:
        answer = call_blocking(light, SetBool.Request(data=on), timeout_s, self._settings.light)
        if not answer.success:
            raise StateError(f"{self._settings.light} does not switch the light: {answer.message}")

    def _pixels(self, name: str, message: Any) -> np.ndarray[Any, np.dtype[np.uint8]]:
        image = grey_image(message, self._settings.topics[name])
        size = self._sizes[name]
        if image.shape != (size.height, size.width):
            raise DataError(
                f"{name} sends images of {image.shape[1]} x {image.shape[0]} px, it is known as {size.width} x "
                f"{size.height} px",
                camera=name,
            )
        return np.array(image if image.dtype == np.uint8 else image >> 8, dtype=np.uint8)


class TopicImages:
    """Newest image of some topics, undecoded.

    Args:
        node: The node that listens; another thread spins it.
        topics: By camera; those that end as image_transport's compressed ones have ``CompressedImage``.
    """

    def __init__(self, node: Any, topics: Mapping[str, str]) -> None:
        self._node, self._topics = node, topics
        self._came = threading.Condition()
        self._newest: dict[str, bytes] = {}
        self._counts = dict.fromkeys(topics, 0)
        self._types = {name: CompressedImage if at.endswith(_COMPRESSED) else Image for name, at in topics.items()}
        self._ends = [self._subscribed(name, topic) for name, topic in topics.items()]

    def counts(self) -> dict[str, int]:
        """Return how many images of each camera have come."""
        with self._came:
            return dict(self._counts)

    def after(self, name: str, count: int, deadline: float, told_s: float) -> Any:
        """Return the first image of a camera that was exposed after a number of images had come.

        The stamp decides where the camera's clock is that of this computer; else the second image is taken, since the
        first may have been exposed before.

        Args:
            name: The camera.
            count: The number.
            deadline: On the monotonic clock [s].
            told_s: How long that is from the beginning, for the message [s].

        Raises:
            WaitTimeoutError: None comes in time.
        """
        asked_ns, came = self._node.get_clock().now().nanoseconds, count
        while True:
            message, came = self._newer(name, came, deadline, told_s)
            late_ns = stamp_of(message.header) - asked_ns
            if late_ns >= 0 if abs(late_ns) <= _ONE_CLOCK_NS else came >= count + 2:
                return message

    def _newer(self, name: str, count: int, deadline: float, told_s: float) -> tuple[Any, int]:
        """Await more images of a camera than a number; return the newest and how many have come."""
        with self._came:
            if not self._came.wait_for(lambda: self._counts[name] > count, max(0.0, deadline - clock.monotonic())):
                raise WaitTimeoutError(what=f"an image of {name} on {self._told(name)}", seconds=told_s)
            return decoded(self._newest[name], self._types[name]), self._counts[name]

    def close(self) -> None:
        """Stop listening."""
        for end in self._ends:
            self._node.destroy_subscription(end)
        self._ends = []

    def _told(self, name: str) -> str:
        """Return the topic, and who publishes there."""
        topic, wanted = self._topics[name], self._types[name].__name__
        types = {end.topic_type for end in self._node.get_publishers_info_by_topic(topic)}
        others = sorted(each for each in types if not each.endswith(f"/{wanted}"))
        return f"{topic} ({'nobody publishes it' if not types else ', '.join(others) or 'it is published'})"

    def _subscribed(self, name: str, topic: str) -> Any:
        def keep(message: bytes) -> None:
            with self._came:
                self._newest[name] = message
                self._counts[name] += 1
                self._came.notify_all()

        return self._node.create_subscription(self._types[name], topic, keep, qos.SENSOR, raw=True)
