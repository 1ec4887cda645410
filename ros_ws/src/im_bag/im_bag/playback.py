"""Pace of a replay: due time of each message, and the effect of pause, step and seek."""

import threading
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain

from im_bag.raw import BagReader
from im_core import clock
from im_core.errors import DataError

#: How far the keys that seek go [s].
JUMP_S = 5.0
#: Messages of a latched topic that come first: several nodes may have latched one each, of which a bag does not tell.
LATCHED = 100
#: An event waits no longer than 292 years, a message may be due later [s].
_LONGEST_WAIT_S = 3600.0
#: A loop begins again no sooner, however short the bag is [s].
_SHORTEST_ROUND_S = 0.1
KEYS = "space: pause, .: step, left and right: 5 s back and on, q: end"

Message = tuple[str, int, bytes]


@dataclass
class Controls:
    """User's controls of the replay; usable from any thread."""

    paused: bool = False
    ended: bool = False
    steps: int = 0
    jump_s: float = 0.0
    changed: threading.Event = field(default_factory=threading.Event)

    def press(self, key: str) -> None:
        """Execute the function of a key, see :data:`KEYS`; ignore other keys."""
        match key:
            case " ":
                self.paused = not self.paused
            case "." if self.paused:
                self.steps += 1
            case "left":
                self.jump_s -= JUMP_S
            case "right":
                self.jump_s += JUMP_S
            case "q":
                self.ended = True
        self.changed.set()

    def take_step(self) -> None:
        """Count a published message as one of the requested steps, if the replay is paused."""
        if self.paused and self.steps:
            self.steps -= 1

    def end(self) -> None:
        """End the replay soon."""
        self.press("q")


class Playback:
    """Messages of a bag, each at the due time.

    Args:
        bag: The bag.
        topics: Which of its topics.
        controls: What the user wants.
        rate: Speed; 2 plays twice as fast.
        start_s: Where to begin, from the first message of the bag [s].
        loop: Whether to begin again at the end.
        begins: Called with the time in the bag [ns] at which it begins, and goes on after each seek.

    Raises:
        DataError: The bag ends before ``start_s``.
    """

    def __init__(
        self,
        bag: BagReader,
        topics: Sequence[str],
        controls: Controls,
        rate: float = 1.0,
        start_s: float = 0.0,
        loop: bool = False,
        begins: Callable[[int], None] | None = None,
    ) -> None:
        if not 0.0 <= start_s <= bag.duration_s:
            raise DataError(f"start {start_s:g} s is not in the bag, 0 to {bag.duration_s:.3f} s", seconds=start_s)
        self._bag, self._topics, self._controls = bag, topics, controls
        self._rate, self._start_s, self._loop, self._begins = rate, start_s, loop, begins

    def messages(self) -> Iterator[Message]:
        """Yield topic, time [ns] and bytes of each message at the due time.

        What was latched before the place where it begins, or goes on after a seek, comes first, with the time of the
        place.
        """
        place_s = self._start_s
        while True:
            begin_ns = self._bag.begin_ns + round(place_s * 1e9)
            if self._begins is not None:
                self._begins(begin_ns)
            for topic, _, data in self._latched(begin_ns):
                yield topic, begin_ns, data
            jumped_to = yield from self._from(begin_ns)
            if jumped_to is not None:
                place_s = min(max(0.0, jumped_to), self._bag.duration_s)
            elif self._loop and not self._controls.ended:
                place_s = self._start_s
            else:
                return

    def _latched(self, begin_ns: int) -> list[Message]:
        """Return the latched messages for a late subscriber at ``begin_ns``, in order of time."""
        deliveries = self._bag.deliveries
        kept = {
            t: deque[Message](maxlen=max(deliveries[t].depth, LATCHED)) for t in self._topics if deliveries[t].latched
        }
        for message in self._until(kept, begin_ns):
            kept[message[0]].append(message)
        return sorted((message for messages in kept.values() for message in messages), key=lambda each: each[1])

    def _until(self, topics: Collection[str], end_ns: int) -> Iterator[Message]:
        return self._bag.messages(topics, end_ns=end_ns) if end_ns > self._bag.begin_ns else iter(())

    def _from(self, begin_ns: int) -> Generator[Message, None, float | None]:
        """Yield messages from a given time on; a looping replay also waits for the end of the bag.

        Returns:
            Where to go on, if the user wants to be elsewhere [s].
        """
        place_s = (begin_ns - self._bag.begin_ns) * 1e-9
        began = clock.monotonic()
        round_s = max(self._bag.duration_s - place_s, _SHORTEST_ROUND_S * self._rate)
        for message in chain(self._bag.messages(self._topics, begin_ns), [None] if self._loop else []):
            after_s = round_s if message is None else (message[1] - begin_ns) * 1e-9
            began += self._wait(began + after_s / self._rate)
            if self._controls.ended:
                return None
            if self._controls.jump_s:
                jump_s, self._controls.jump_s = self._controls.jump_s, 0.0
                passed_s = (clock.monotonic() - began) * self._rate
                return place_s + min(passed_s, after_s) + jump_s
            if message is not None:
                self._controls.take_step()
                yield message
        return None

    def _wait(self, due: float) -> float:
        """Wait until a message is due, or something else is wanted; returns how long the pace stood still [s]."""
        controls, paused_s = self._controls, 0.0
        while not controls.ended and not controls.jump_s:
            controls.changed.clear()
            if controls.ended or controls.jump_s:
                break
            if controls.paused:
                if controls.steps:
                    return clock.monotonic() - due
                stopped = clock.monotonic()
                controls.changed.wait()
                paused_s += clock.monotonic() - stopped
                continue
            left = due + paused_s - clock.monotonic()
            if left <= 0.0:
                break
            controls.changed.wait(min(left, _LONGEST_WAIT_S))
        return paused_s
