"""Recordings of cameras: images of a bag's topic, and of a video file, each with its stamp."""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from im_bag.reading import messages_of, topics_of
from im_calibration.recorded.image_message import Image, grey_image
from im_calibration.recorded.stamps import Stamps, stamp_of
from im_core.errors import DataError
from im_core.files import check_regular

IMAGE_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
VIDEOS = (".avi", ".mkv", ".mov", ".mp4", ".mpg", ".mpeg", ".webm", ".m4v", ".ts")


class ImageRecording(ABC):
    """Images of one camera over time.

    Attributes:
        name: Where they are from, for errors.
        stamps: Ascending, shape (m,) [ns].
        told: Sentence on what is wrong with it but can be used; empty: nothing.
    """

    name: str
    stamps: Stamps
    told: str = ""

    @abstractmethod
    def images(self, chosen: Collection[int]) -> Iterator[tuple[int, Image]]:
        """Yield rank by stamp and grey image, of 8 or 16 bits, of some images, in the order of recording.

        Raises:
            DataError: One cannot be read.
        """


class BagImages(ImageRecording):
    """Images of a topic of a bag, by their stamps; where no image is stamped, by the times of recording.

    Args:
        bag: The bag.
        topic: Of ``sensor_msgs/Image`` or ``sensor_msgs/CompressedImage``.

    Raises:
        DataError: The bag cannot be read, or has no images on the topic.
    """

    def __init__(self, bag: Path, topic: str) -> None:
        self.name = f"{bag}: {topic}"
        self._bag, self._topic = bag, topic
        found = topics_of(bag)
        if topic not in found:
            images = [each for each, kind in found.items() if kind in IMAGE_TYPES]
            hint = f"; topics of images are {', '.join(sorted(images))}" if images else "; no topic of it has images"
            raise DataError(f"{bag}: there is no topic '{topic}' in it{hint}.", topic=topic)
        pairs = [(stamp_of(message.content.header), message.logged_ns) for message in self._messages()]
        if not pairs:
            raise DataError(f"{bag}: there is nothing on topic '{topic}' in it.", topic=topic)
        unstamped = sum(not stamp for stamp, _ in pairs)
        if 0 < unstamped < len(pairs):
            raise DataError(f"{bag}: {unstamped} of {len(pairs)} messages on '{topic}' have no stamp.", topic=topic)
        stamps = np.array([logged if unstamped else stamp for stamp, logged in pairs], dtype=np.int64)
        order = np.argsort(stamps, kind="stable")
        self.stamps, self._rank = stamps[order], np.argsort(order)

    def images(self, chosen: Collection[int]) -> Iterator[tuple[int, Image]]:
        """Yield images of the topic."""
        wanted = set(chosen)
        for rank, message in zip(self._rank.tolist(), self._messages(), strict=True):
            if rank in wanted:
                yield rank, grey_image(message.content, self.name)

    def _messages(self) -> Iterator[Any]:
        return messages_of(self._bag, {self._topic: IMAGE_TYPES})


class VideoFile(ImageRecording):
    """Images of a video file; stamps begin near 0.

    Raises:
        DataError: It cannot be read, or has no images.
    """

    def __init__(self, path: Path) -> None:
        self.name, self._path = str(path), path
        capture = self._opened()
        rate, promised = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
        times = list[float]()
        while capture.grab():
            times.append(1e6 * capture.get(cv2.CAP_PROP_POS_MSEC))
        capture.release()
        if not times:
            raise DataError(f"{path}: has no image that can be read; is the video cut off?", file=str(path))
        if np.any(np.diff(times) <= 0.0):  # a container without times
            times = [1e9 * i / (rate if rate > 0.0 else 30.0) for i in range(len(times))]
        self.stamps = np.array(times, dtype=np.int64)
        if len(times) < promised:
            self.told = f"{path}: ends after {len(times)} of {promised} images, it is cut off"

    def images(self, chosen: Collection[int]) -> Iterator[tuple[int, Image]]:
        """Yield images of the file."""
        wanted, capture = set(chosen), self._opened()
        for i in range(len(self.stamps)):
            if not capture.grab():
                break
            if i in wanted:
                read, image = capture.retrieve()
                if read:
                    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
                    yield i, np.asarray(grey, dtype=np.uint8)
        capture.release()

    def _opened(self) -> cv2.VideoCapture:
        try:
            check_regular(self._path, self._path.stat())
        except OSError as error:
            raise DataError(f"{self._path}: cannot be read: {error.strerror}.", file=self.name) from error
        capture = cv2.VideoCapture(str(self._path))
        if not capture.isOpened():
            raise DataError(f"{self._path}: is no video that can be read; is it cut off?", file=self.name)
        return capture
