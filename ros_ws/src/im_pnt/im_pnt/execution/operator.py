"""Modes of operation: automatic, confirmed firings, single steps; and the pause."""

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
        free: Whether the net runs by itself.
        proposed: Transitions that wait to be confirmed, in the order in which they were found enabled.
    """

    def __init__(self, written: Iterable[int], accepting: Iterable[int]) -> None:
        self.written = frozenset(written)
        self.mode = Mode.AUTOMATIC
        self.paused = False
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
        return frozenset() if free else self.written

    @property
    def asks(self) -> bool:
        """Whether transitions are to be proposed."""
        return self.mode is Mode.SUPERVISED and not self.paused

    def set_mode(self, mode: Mode) -> None:
        """Set the mode."""
        self.mode = mode
        self.free = mode is Mode.AUTOMATIC and not self.paused
        self._credit = False

    def pause(self, paused: bool) -> None:
        """Has nothing new started, or everything go on."""
        self.paused = paused
        self.free = self.mode is Mode.AUTOMATIC and not paused

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
