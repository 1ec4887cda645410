"""Decisions of the Motion Coordinator: target of an arm, state of an arm, validity of a position."""

from collections.abc import Iterable, Mapping, MutableMapping, Sequence
from typing import Any, Protocol

from im_core.errors import DataError, StateError

#: States of MCS and of each group (paper, Figure 7); those of a group in which it has its slots, and power.
STATES = frozenset({"unconfigured", "cold", "reserved", "active", "motion", "estopped"})
HOLDING_STATES = frozenset({"reserved", "active", "motion"})
POWERED_STATES = frozenset({"active", "motion"})
#: States of MCS in which nothing moves before somebody recovers it.
STOPPED_STATES = frozenset({"unconfigured", "estopped"})

#: Arguments that say to where a path is planned.
DESTINATIONS = ("destination", "position", "joints", "posture")


class ToldGroup(Protocol):
    """State of a group on ``/mcs/state``: ``im_msgs/GroupStatus``."""

    group: str
    state: str
    reserved: bool
    owner: str


def check_told(state: str, groups: Iterable[ToldGroup]) -> None:
    """Check a message from ``/mcs/state`` for states possible in MCS; refuse any other message.

    Raises:
        DataError: It is no state, or one of a group is none.
    """
    for who, told in (("MCS", state), *((f"group '{group.group[:40]}'", group.state) for group in groups)):
        if told not in STATES:
            text = f"{who} cannot be '{told[:40]}'; its states are {', '.join(sorted(STATES))}"
            raise DataError(text, state=told[:40])


def state_for(groups: Iterable[ToldGroup], group: str, owner: str) -> str:
    """Return the state of a group for an owner: cold unless reserved for the owner, or for anyone."""
    held = (told.state for told in groups if told.group == group and told.reserved and told.owner in ("", owner))
    return next(held, "cold")


def way_asked(arguments: Mapping[str, object], ways: tuple[str, ...], what: str) -> str:
    """Return the one argument with the destination of a move; all other candidates are empty.

    Args:
        arguments: Of the request.
        ways: Which may say so.
        what: What is asked for, for the message.

    Raises:
        DataError: None says so, or several do.
    """
    given = [name for name in ways if arguments.get(name)]
    if len(given) != 1:
        told = " and ".join(given) or "none"
        raise DataError(f"{what} needs one of the arguments {', '.join(ways)}; it was given {told}", given=given)
    return given[0]


def planned_beforehand(arguments: Mapping[str, object], memory: Mapping[str, object]) -> bool:
    """Return whether the path of a move was planned before the request, and the arm still stands at the path's start.

    Args:
        arguments: Of the request.
        memory: What its actions have kept; a move in doubt has taken the path, and nobody knows where the arm is on it.
    """
    return bool(arguments["planned"]) and "path_taken" not in memory


def take_path(memory: MutableMapping[str, object]) -> None:
    """Take the path planned beforehand, once."""
    memory["path_taken"] = True


def depends_on_here(arguments: Mapping[str, object]) -> bool:
    """Return whether the destination of a move depends on the tool's place at planning time."""
    return bool(arguments["position"]) and (arguments["frame"] == "tool" or not arguments["orientation"])


def note_end(memory: MutableMapping[str, object], positions: Sequence[float]) -> None:
    """Store the end of a path about to be followed.

    Args:
        memory: Of the request.
        positions: Joint positions at its end, shape (n,) [rad, m]; of a line position [m] and quaternion of the wrist.
    """
    memory["leads_to"] = [float(position) for position in positions]


def end_noted(memory: Mapping[str, object]) -> Any:
    """Return the end of the path followed for a request, None without a path or without need for the end.

    Args:
        memory: Of the request; of a move in doubt nobody knows how far its arm has gone: it may be there already.
    """
    return memory.get("leads_to")


def require_working(state: str, reason: str, what: str) -> None:
    """Check for a state of MCS in which parts move.

    Raises:
        StateError: Nothing moves.
    """
    if state in STOPPED_STATES:
        raise StateError(f"{what} does not move, for MCS is {state}" + (f": {reason}" if reason else ""))


def require_rest(group: str, at_rest: bool, reason: str = "") -> None:
    """Check for rest: a position counts only at rest.

    Args:
        group: Name of the group.
        at_rest: Whether it rests.
        reason: Why MCS is in its state, if it says so: what stopped the group may have set it swinging.

    Raises:
        StateError: The group moves.
    """
    if not at_rest:
        because = f" (MCS: {reason})" if reason else ""
        raise StateError(f"{group} is not at rest; a position measured in motion is of no use{because}")
