"""Looks: exposed images with a search for the light, going on while the arms move."""

import threading
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as StillSearching
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from im_core import clock
from im_core.errors import DataError, StateError, WaitTimeoutError

Found = TypeVar("Found")

_SLICE_S = 0.2
MOST_LOOKS = 16
"""Looks that are known, at most; of more the oldest are forgotten."""

FORGOTTEN = "look_forgotten"
"""Code of the failure of whoever asks for a look that is not known: it was of a former incarnation, or is long past."""


@dataclass(frozen=True)
class Look(Generic[Found]):
    """One look.

    Attributes:
        cameras: Which cameras were exposed.
        found: What is found in their images, as soon as it is.
    """

    cameras: tuple[str, ...]
    found: "Future[Found]" = field(default_factory=Future)


class Looks(Generic[Found]):
    """The latest looks by name; any thread may keep one and ask for the result, as often as needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._looks: OrderedDict[str, Look[Found]] = OrderedDict()

    def keep(self, name: str, look: Look[Found]) -> None:
        """Keep a look under a name."""
        with self._lock:
            self._looks.pop(name, None)  # of a former incarnation of the testbed, whose time was the same
            self._looks[name] = look
            while len(self._looks) > MOST_LOOKS:
                self._looks.popitem(last=False)

    def found(self, name: str, cameras: tuple[str, ...], timeout_s: float, check: Callable[[], None]) -> Found:
        """Wait for and return the result of a look.

        Args:
            name: Of the look.
            cameras: Those that are asked for.
            timeout_s: How long to wait, wall time [s].
            check: Raises what shall end the wait; called now and then.

        Raises:
            StateError: There is no such look any more, code :data:`FORGOTTEN`.
            DataError: It was by other cameras.
            WaitTimeoutError: The search takes longer.
            ImError: As raised by the search, or by the check.
        """
        with self._lock:
            look = self._looks.get(name)
        if look is None:
            raise StateError(f"look {name} is not known: its images are gone", code=FORGOTTEN, look=name)
        if look.cameras != cameras:
            told = f"look {name} was by {', '.join(look.cameras)}, not by {', '.join(cameras)}"
            raise DataError(told, look=name, cameras=list(look.cameras))
        deadline = clock.monotonic() + timeout_s
        while True:
            left_s = deadline - clock.monotonic()
            try:
                return look.found.result(max(0.0, min(left_s, _SLICE_S)))
            except StillSearching:
                if left_s <= _SLICE_S:
                    what = f"/vss to find the light in the images of {', '.join(look.cameras)} (look {name})"
                    raise WaitTimeoutError(what=what, seconds=timeout_s) from None
            check()
