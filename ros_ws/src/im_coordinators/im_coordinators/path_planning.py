"""What a Coordinator tries before it hands an error up (paper, section 6)."""

from collections.abc import Sequence

#: MCS states with power on (paper, section 4).
POWERED_STATES = frozenset({"active", "motion"})

#: MCS states in which a group is held.
HOLDING_STATES = frozenset({"reserved", "active", "motion"})

#: A blocked straight joint path may be circumvented; an unreachable goal may not.
DETOUR_FAILURES = frozenset({"collision"})

#: Spots that were too faint, or too near to something else, may show in a longer exposure.
LOOK_AGAIN_CAUSES = ("too faint", "candidates")

#: Factor on the exposure of another look.
LONGER_EXPOSURE = 2.0


def another_look_may_help(causes: Sequence[str]) -> bool:
    """Whether a longer exposure may show spots that were missed for these causes."""
    return bool(causes) and all(any(hope in cause for hope in LOOK_AGAIN_CAUSES) for cause in causes)


def detour(start: Sequence[float], goal: Sequence[float], tucked: Sequence[float], arm: int) -> list[list[float]]:
    """A path around an obstacle: tuck the arm, let the cart travel, stretch the arm again.

    Args:
        start: Joint positions now, shape (n,) [rad, m].
        goal: Joint positions wanted, shape (n,) [rad, m].
        tucked: Joint positions in which the arm is out of the way, shape (n,) [rad, m].
        arm: Index of the first arm joint; those before it belong to the cart.

    Returns:
        Points behind ``start``, the last one is ``goal``.
    """
    return [[*start[:arm], *tucked[arm:]], [*goal[:arm], *tucked[arm:]], list(goal)]
