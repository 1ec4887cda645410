"""What the Motion Coordinator decides: which arm is meant, and whether MCS has to be powered for it."""

from collections.abc import Sequence

from im_core.errors import StateError

#: MCS states with power on (paper, section 4).
POWERED_STATES = frozenset({"active", "motion"})

#: MCS states in which a group is held.
HOLDING_STATES = frozenset({"reserved", "active", "motion"})

#: The arm that moves where nobody says which.
DEFAULT_GROUP = "left"


def carrier_of(light: str) -> str:
    """Name of the group that carries a light."""
    return light.removesuffix("_led")


def group_held(reserved: Sequence[str]) -> str:
    """The group that moves, of those that MCS has reserved."""
    return DEFAULT_GROUP if DEFAULT_GROUP in reserved or not reserved else reserved[0]


def require_rest(group: str, at_rest: bool) -> None:
    """A position counts only at rest.

    Raises:
        StateError: The group moves.
    """
    if not at_rest:
        raise StateError(f"{group} is not at rest; a position measured in motion is of no use")
