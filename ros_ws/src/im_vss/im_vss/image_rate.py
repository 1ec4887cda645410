"""When cameras take images without being asked."""

import math


class Rhythm:
    """Schedule of images: cameras are due at the multiples of the periods, in testbed time.

    Cameras of the same rate are therefore exposed together. What falls into an exposure is left out. Where testbed time
    passes only for those who want it, it waits for what is due, and an exposure makes time pass; images never follow
    from that time alone, else they would drive the clock on for ever.
    """

    def __init__(self) -> None:
        self._rates: dict[str, float] = {}
        self._last: dict[str, int] = {}
        self._now_ns = 0
        self._rest_ns = -1

    @property
    def active(self) -> bool:
        """Whether any camera has a rate."""
        return bool(self._rates)

    def set_rate(self, camera: str, rate: float) -> None:
        """Set the images a second of testbed time of a camera [Hz]; 0: none. The first one is due at once."""
        if rate == self._rates.get(camera, 0.0):
            return
        self._last.pop(camera, None)
        self._rates.pop(camera, None)
        if rate > 0.0:
            self._rates[camera] = rate

    def due(self, now_ns: int) -> tuple[str, ...]:
        """Return cameras due at a testbed time [ns], each once in a period."""
        if now_ns < self._now_ns:  # another testbed, which begins at 0
            self._last.clear()
            self._rest_ns = -1
        self._now_ns = now_ns
        rests = now_ns <= self._rest_ns
        found = tuple(
            camera
            for camera in self._rates
            if camera not in self._last or (not rests and self._period(camera, now_ns) > self._last[camera])
        )
        self._last |= {camera: self._period(camera, now_ns) for camera in found}
        return found

    def taken(self, cameras: tuple[str, ...], end_ns: int) -> None:
        """Note cameras exposed until a testbed time [ns]: none is due again before the time passes on."""
        self._rest_ns = end_ns
        for camera in cameras:
            if camera in self._last:
                self._last[camera] = max(self._last[camera], self._period(camera, end_ns))

    @property
    def next_ns(self) -> int | None:
        """From which testbed time on the next image is due [ns], 0 if one is at once; None if none is."""
        return min((self._next(camera) for camera in self._rates), default=None)

    def _next(self, camera: str) -> int:
        if camera not in self._last:
            return 0
        start_ns = math.ceil((self._last[camera] + 1) * 1e9 / self._rates[camera])
        while self._period(camera, start_ns) <= self._last[camera]:  # by rounding
            start_ns += 1
        return max(start_ns, self._rest_ns + 1)

    def _period(self, camera: str, time_ns: int) -> int:
        """Return the number of the period of a camera at a time."""
        return int(time_ns * self._rates[camera] / 1e9)
