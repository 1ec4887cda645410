"""Where the time of a Service, or of a camera, goes."""

from collections.abc import Iterator
from contextlib import contextmanager

from im_core import clock


class Stopwatch:
    """Adds up wall time by step."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._start = clock.monotonic()

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Count the time of a ``with`` block towards the step `name`."""
        begin = clock.monotonic()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + clock.monotonic() - begin

    def report(self) -> dict[str, float]:
        """Seconds by step, and `total_s` since the start."""
        return {**self.seconds, "total_s": clock.monotonic() - self._start}
