"""What was refused on topics, where nobody waits for an answer."""

import threading
from collections import Counter

from rclpy.impl.rcutils_logger import RcutilsLogger

from im_core.errors import ImError


class Refusals:
    """Counts refused messages by topic, and says each sentence once; fit for several threads.

    Args:
        logger: Of the node.
    """

    def __init__(self, logger: RcutilsLogger) -> None:
        self._logger = logger
        self._lock = threading.Lock()
        self._counts: Counter[str] = Counter()
        self._last: dict[str, str] = {}

    def add(self, topic: str, error: ImError) -> None:
        """A message on ``topic`` was refused, or what it asked for ended badly."""
        with self._lock:
            self._counts[topic] += 1
            told = self._last.get(topic) == error.message
            self._last[topic] = error.message
        if not told:
            self._logger.warning(f"{topic}: {error.message}")

    def counts(self) -> dict[str, int]:
        """Number of refused messages by topic."""
        with self._lock:
            return dict(self._counts)
