"""The Vision Module Manager: first-come leases of Vision Modules."""

import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from im_core import clock
from im_core.errors import NotFoundError, StateError, WaitTimeoutError

_SLICE_S = 0.2


@dataclass(eq=False)
class VisionClient:
    """Client of Vision Modules: one request of a Service.

    Attributes:
        name: For messages, e.g. ``spot_find #12``.
        alive: Whether whoever asked still waits for the answer.
        tell: Is told what whoever asked must know beside the answer, a clause; maybe several times.
    """

    name: str
    alive: Callable[[], bool] = lambda: True
    tell: Callable[[str], None] = lambda remark: None
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _cancelled: bool = False
    _committed: bool = False

    def cancel(self) -> None:
        """Give up: waiting ends, leases end.

        Raises:
            StateError: It is too late.
        """
        with self._lock:
            if self._committed:
                raise StateError(f"{self.name} has ended and cannot be cancelled", request=self.name)
            self._cancelled = True

    def commit(self) -> None:
        """Go on to the end: later steps are not undone, and the answer is the outcome.

        Raises:
            StateError: Nobody wants the answer any more.
        """
        with self._lock:
            self.check()
            self._committed = True

    @property
    def gone(self) -> bool:
        """Whether nobody wants the answer any more."""
        return self._cancelled or not (self._committed or self.alive())

    def check(self) -> None:
        """Refuse to go on for nobody.

        Raises:
            StateError: Nobody wants the answer any more.
        """
        if self.gone:
            raise StateError(f"{self.name} was cancelled, or its client has gone", request=self.name)


def _nothing() -> float:
    return 0.0


@dataclass(eq=False)
class Lease:
    """A Vision Module lent to a client.

    Attributes:
        module: Name of the module.
        client: Who holds it.
        deadline: When it ends by itself [s of `now`], and later by what is spared.
        hold_s: How long it was given for [s].
        now: The clock it is measured with.
        spared: Time that does not count [s]: what only computes is not late where it gets no processor.
    """

    module: str
    client: VisionClient
    deadline: float
    hold_s: float
    now: Callable[[], float] = clock.monotonic
    released: bool = False
    spared: Callable[[], float] = _nothing

    def remaining(self) -> float:
        """Time left [s], at least 0."""
        return max(0.0, self.deadline + self.spared() - self.now())

    @property
    def valid(self) -> bool:
        """Whether the holder may use the module."""
        return not self.released and not self.client.gone and self.remaining() > 0.0

    def check(self, module: str) -> None:
        """Refuse a use beyond the lease.

        Raises:
            StateError: It is for another module, or over.
        """
        if module != self.module:
            raise StateError(f"{self.client.name} holds a lease of {self.module}, not of {module}", module=module)
        if not self.valid:
            raise StateError(f"the lease of {module} by {self.client.name} is over", module=module)


@dataclass(frozen=True)
class ModuleState:
    """Users of a Vision Module.

    Attributes:
        owner: Name of the client that holds it; empty if it is free.
        remaining_s: Time left of its lease [s].
        queue: Names of those who wait, first come first.
        leases: Given since the start.
        released: Of these, given back by their owner in time.
        lapsed: Of these, ended by their deadline or the cancellation or death of their owner.
    """

    owner: str
    remaining_s: float
    queue: tuple[str, ...]
    leases: int
    released: int
    lapsed: int


@dataclass
class _Count:
    leases: int = 0
    released: int = 0
    lapsed: int = 0


class VisionModuleManager:
    """Manager of Vision Modules: lends each to one client at a time, in the order of the requests.

    A lease ends with its release, its deadline, or the cancellation or death of its client, whichever comes first; the
    wait for one is bounded.
    """

    def __init__(
        self,
        name: str,
        modules: Mapping[str, float],
        wait_s: float,
        now: Callable[[], float] = clock.monotonic,
    ) -> None:
        """Manage some modules.

        Args:
            name: Name of the manager.
            modules: Its modules by name, each with the longest lease [s].
            wait_s: Longest wait for a lease [s].
            now: Clock that deadlines are measured with [s].
        """
        self.name = name
        self.wait_s = wait_s
        self._longest = dict(modules)
        self._now = now
        self._changed = threading.Condition()
        self._queues: dict[str, deque[VisionClient]] = {module: deque() for module in modules}
        self._held: dict[str, Lease] = {}
        self._counts = {module: _Count() for module in self._queues}

    @contextmanager
    def lend(self, module: str, client: VisionClient) -> Iterator[Lease]:
        """Wait for a module, lend the module for a ``with`` block, take the module back.

        Raises:
            NotFoundError: The manager has no such module.
            StateError: The client gave up while it waited.
            WaitTimeoutError: The module did not become free in time.
        """
        lease = self._acquire(module, client)
        try:
            yield lease
        finally:
            with self._changed:
                count = self._counts[module]
                count.released += lease.valid
                count.lapsed += not lease.valid
                lease.released = True
                self._changed.notify_all()

    def state(self, module: str) -> ModuleState:
        """Return the owner of a module, and the queue."""
        with self._changed:
            held, count = self._held.get(module), self._counts[module]
            owned = held is not None and held.valid
            return ModuleState(
                owner=held.client.name if held is not None and owned else "",
                remaining_s=held.remaining() if held is not None and owned else 0.0,
                queue=tuple(client.name for client in self._queues[module]),
                leases=count.leases,
                released=count.released,
                lapsed=count.lapsed,
            )

    def _acquire(self, module: str, client: VisionClient) -> Lease:
        queue = self._queues.get(module)
        if queue is None:
            raise NotFoundError(kind=f"vision module of {self.name}", name=module, known=self._queues)
        give_up = self._now() + self.wait_s
        with self._changed:
            queue.append(client)
            try:
                while not (self._first(queue) is client and self._free(module)):
                    if client.gone:
                        raise StateError(f"{client.name} gave up waiting for {module}", module=module)
                    if self._now() >= give_up:
                        raise WaitTimeoutError(what=self._whom(module, client), seconds=self.wait_s)
                    self._changed.wait(self._slice(module, give_up))
                if client.gone:
                    raise StateError(f"{client.name} gave up waiting for {module}", module=module)
                hold_s = self._longest[module]
                lease = Lease(module, client, self._now() + hold_s, hold_s, self._now)
                self._held[module] = lease
                self._counts[module].leases += 1
                return lease
            finally:
                if client in queue:
                    queue.remove(client)
                self._changed.notify_all()

    @staticmethod
    def _first(queue: deque[VisionClient]) -> VisionClient | None:
        """Return the first waiting client; remove departed clients from the queue."""
        while queue and queue[0].gone:
            queue.popleft()
        return queue[0] if queue else None

    def _free(self, module: str) -> bool:
        held = self._held.get(module)
        return held is None or not held.valid

    def _slice(self, module: str, give_up: float) -> float:
        """How long to sleep: until something may have changed without a notice [s]."""
        held = self._held.get(module)
        left = [give_up - self._now()] + ([held.remaining()] if held is not None and held.valid else [])
        return min(max(min(left), 0.0), _SLICE_S)

    def _whom(self, module: str, client: VisionClient) -> str:
        held = self._held.get(module)
        holder = held.client.name if held is not None and held.valid else "nobody"
        queue = self._queues[module]
        ahead = queue.index(client) if client in queue else 0
        return f"{module}, held by {holder}, {ahead} before {client.name}"
