"""The right to use a Vision Module for a while."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from im_core import clock
from im_core.errors import StateError


@dataclass(eq=False)
class VisionClient:
    """Who asks for Vision Modules: one request of a Service.

    Attributes:
        name: For messages, e.g. ``spot_find #12``.
        alive: Whether whoever asked still waits for the answer.
    """

    name: str
    alive: Callable[[], bool] = lambda: True
    _cancelled: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Give up: waiting ends, leases end."""
        self._cancelled.set()

    @property
    def gone(self) -> bool:
        """Whether nobody wants the answer any more."""
        return self._cancelled.is_set() or not self.alive()


@dataclass(eq=False)
class Lease:
    """A Vision Module lent to a client.

    Attributes:
        module: Name of the module.
        client: Who holds it.
        deadline: When it ends by itself [s of `now`].
        hold_s: How long it was given for [s].
        now: The clock it is measured with.
    """

    module: str
    client: VisionClient
    deadline: float
    hold_s: float
    now: Callable[[], float] = clock.monotonic
    released: bool = False

    def remaining(self) -> float:
        """Time left [s], at least 0."""
        return max(0.0, self.deadline - self.now())

    @property
    def valid(self) -> bool:
        """Whether the holder may use the module."""
        return not self.released and not self.client.gone and self.now() < self.deadline

    def check(self, module: str) -> None:
        """Refuse what this lease does not cover.

        Raises:
            StateError: It is for another module, or over.
        """
        if module != self.module:
            raise StateError(f"{self.client.name} holds a lease of {self.module}, not of {module}", module=module)
        if not self.valid:
            raise StateError(f"the lease of {module} by {self.client.name} is over", module=module)
