"""Attempts of the Path Planning Coordinator before an error is handed up (paper, section 6)."""

from collections.abc import Mapping, Sequence

from im_core.errors import DataError, ImError

#: An arm is at home where no joint is further from there [rad, m].
AT_HOME = 0.01

#: A blocked straight joint path may be circumvented; an unreachable goal may not.
DETOUR_FAILURES = frozenset({"collision"})


def configuration(positions: object, joints: Sequence[str], group: str) -> list[float]:
    """Return the joint positions requested.

    Args:
        positions: Of each joint of the group, in its order [rad or m].
        joints: Names of the joints of the group.
        group: Its name, for the message.

    Raises:
        DataError: They are not as many as the joints.
    """
    wanted = _numbers(positions)
    if len(wanted) != len(joints):
        text = f"argument joints has {len(wanted)} positions; {group} has {len(joints)} joints: {', '.join(joints)}"
        raise DataError(text, argument="joints", value=len(wanted), allowed=len(joints))
    return wanted


def require_joints(named: Sequence[str], joints: Sequence[str], group: str) -> None:
    """Check a given path for the joints of the following group, in the group's order.

    Raises:
        DataError: It is for others.
    """
    if list(named) != list(joints):
        told = ", ".join(named) or "joints without names"
        raise DataError(f"the given path is for {told}; {group} has the joints {', '.join(joints)}", group=group)


def _numbers(values: object) -> list[float]:
    return [float(value) for value in values] if isinstance(values, list | tuple) else []


def detour_may_help(failure: ImError | None) -> bool:
    """Whether a way around the obstacle is worth a try."""
    return failure is not None and failure.code in DETOUR_FAILURES


def another_may_help(failure: ImError | None, memory: Mapping[str, object]) -> bool:
    """Whether another configuration is worth a try: once for each request."""
    return detour_may_help(failure) and "another" not in memory


def home_seed(position: Sequence[float], home: Sequence[float]) -> list[float]:
    """Return the seed of a search for a configuration near home: home, or the place of an arm already there.

    Args:
        position: Joint positions now, shape (n,) [rad, m].
        home: Joint positions at home, shape (n,) [rad, m].
    """
    there = all(abs(here - wanted) < AT_HOME for here, wanted in zip(position, home, strict=True))
    return list(position if there else home)


def tucked_seed(position: Sequence[float], tucked: Sequence[float], carriers: int) -> list[float]:
    """Return the seed of a search for another configuration: the arm out of the way, at the present place.

    Args:
        position: Joint positions now, shape (n,) [rad, m].
        tucked: Joint positions in which the arm is out of the way, shape (n,) [rad, m].
        carriers: How many of the joints, the first ones, carry the arm.
    """
    return [*position[:carriers], *tucked[carriers:]]


def detour(start: Sequence[float], goal: Sequence[float], tucked: Sequence[float], carriers: int) -> list[list[float]]:
    """Return a path around an obstacle: tuck the arm, move the carriers, stretch the arm again.

    Args:
        start: Joint positions now, shape (n,) [rad, m].
        goal: Joint positions wanted, shape (n,) [rad, m].
        tucked: Joint positions in which the arm is out of the way, shape (n,) [rad, m].
        carriers: How many of the joints, the first ones, carry the arm.

    Returns:
        Points behind ``start``, the last one is ``goal``.
    """
    return [tucked_seed(start, tucked, carriers), tucked_seed(goal, tucked, carriers), list(goal)]
