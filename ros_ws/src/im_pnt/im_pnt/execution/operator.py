"""Modes of operation: automatic, confirmed firings, single steps; the pause, and breakpoints."""

import enum
from collections.abc import Iterable


class Mode(enum.StrEnum):
    """How a net is operated."""

    AUTOMATIC = "automatic"
    SUPERVISED = "supervised"
    STEP = "step"


class Operator:
    """Permissions of the operator of a net. Numbers are transition numbers of the expanded net.

    Args:
        written: Transitions as their author wrote them: with an action their ``t.start``.
        accepting: Those that accept requests.

    Attributes:
        written: As given.
        mode: How the net is operated.
        paused: Whether nothing new is started; what runs goes on.
        breakpoints: Transitions that wait to be confirmed, whatever the mode.
        free: Whether the net runs by itself.
        proposed: Transitions that wait to be confirmed, in the order in which they were found enabled.
    """

    def __init__(self, written: Iterable[int], accepting: Iterable[int]) -> None:
        self.written = frozenset(written)
        self.mode = Mode.AUTOMATIC
        self.paused = False
        self.breakpoints: set[int] = set()
        self.free = True
        self.proposed: dict[int, None] = {}
        self._new = self.written | frozenset(accepting)
        self._held: dict[int, None] = {}
        self._credit = False

    @property
    def barred(self) -> frozenset[int]:
        """Transitions now barred from firing without the operator."""
        if self.paused:
            return self._new
        free = self.mode is Mode.AUTOMATIC or (self.mode is Mode.STEP and self._credit)
        return frozenset(self.breakpoints) if free else self.written

    def asks(self, transition: int) -> bool:
        """Return whether an enabled transition is to be proposed."""
        stops = self.mode is Mode.SUPERVISED or transition in self.breakpoints
        return stops and not self.paused and transition in self.written

    @property
    def idle(self) -> bool:
        """Whether the net runs by itself, and waits for no confirmation."""
        return self.mode is Mode.AUTOMATIC and not self.paused and not self.proposed

    def set_mode(self, mode: Mode) -> None:
        """Set the mode."""
        self.mode = mode
        self._credit = False
        self._changed()

    def pause(self, paused: bool) -> None:
        """Has nothing new started, or everything go on."""
        self.paused = paused
        self._changed()

    def set_breakpoint(self, transition: int, on: bool) -> None:
        """Have a transition wait to be confirmed at each firing, or no more."""
        (self.breakpoints.add if on else self.breakpoints.discard)(transition)
        self._changed()

    def hold(self, transition: int) -> None:
        """Keep an enabled transition until firing is allowed again."""
        self._held[transition] = None

    @property
    def may_step(self) -> bool:
        """Whether a transition is held back until a step is asked for."""
        return bool(self._held) and self.mode is Mode.STEP and not self.paused

    def step(self) -> bool:
        """Allow one firing, if a transition waits for permission; return whether one does."""
        self._credit = self.may_step
        return self._credit

    def spent(self) -> None:
        """End a step: the transition has fired, or nothing is left to decide."""
        self._credit = False

    def release(self) -> list[int]:
        """Take out held and proposed transitions, for a new decision."""
        released = [*self.proposed, *self._held]
        self.proposed.clear()
        self._held.clear()
        return released

    def _changed(self) -> None:
        self.free = self.mode is Mode.AUTOMATIC and not self.paused and not self.breakpoints
