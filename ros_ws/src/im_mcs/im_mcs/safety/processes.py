"""Watches of those who take part: the servo's own deadlines, the owner process, the clients with a lease."""

import math

from im_core.errors import ImError, LinkError, StateError
from im_mcs.safety.watch import Finding, Reaction, Situation
from im_mcs.state.reservation import Reservations


class OverrunWatch:
    """Servo deadlines were missed in a row.

    Args:
        bound: How many are too many.
    """

    def __init__(self, bound: int) -> None:
        self._bound = bound

    def check(self, now: Situation) -> Finding | None:
        """A single overrun is skipped and counted; several in a row are a protective stop."""
        if now.overruns < self._bound:
            return None
        fault = ImError(f"{now.overruns} servo deadlines in a row were missed", code="overrun", missed=now.overruns)
        return Finding(Reaction.PROTECTIVE_STOP, fault)


class OwnerWatch:
    """The process that owns the servo (the ``mcs`` node) gives no sign of life.

    Args:
        bound_s: Wall time without one [s].
    """

    def __init__(self, bound_s: float) -> None:
        self._bound_s = bound_s

    def check(self, now: Situation) -> Finding | None:
        """Nobody could command a stop any more: the goals end; the core then switches power off."""
        if now.owner_silence_s <= self._bound_s:
            return None
        silent = "is gone"
        if math.isfinite(now.owner_silence_s):
            silent = f"gave no sign of life for {now.owner_silence_s:.2g} s, {self._bound_s:g} s are allowed"
        return Finding(Reaction.END, LinkError(f"the process that owns the servo {silent}"))


class LeaseWatch:
    """A client that reserved a group with a lease has not renewed it.

    Args:
        reservations: Owners and leases.
    """

    def __init__(self, reservations: Reservations) -> None:
        self._reservations = reservations

    def check(self, now: Situation) -> Finding | None:
        """The groups of the client decelerate and hold; their goals end."""
        lapsed = self._reservations.lapse(now.measured.stamp_ns)
        if not lapsed:
            return None
        first = lapsed[0]
        groups = tuple(r.group for r in lapsed if r.owner == first.owner)
        named = ", ".join(f"'{group}'" for group in groups)
        fault = StateError(
            f"the lease of owner '{first.owner}' on {named} lapsed: it was not renewed for {first.lease_s:g} s",
            owner=first.owner,
            groups=list(groups),
        )
        fault.code = "lease"
        return Finding(Reaction.END, fault, groups)
