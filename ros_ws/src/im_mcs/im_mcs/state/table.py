"""The state table: allowed requests of each state, and the next states (paper, Figure 7).

Every group is in a state of its own. The machine's is the highest that any group is in, in the order of
:data:`STATES`; unconfigured and estopped are of all groups together.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from im_core.errors import StateError


class State(StrEnum):
    """States of MCS and of each of the groups; all but the first are the paper's."""

    UNCONFIGURED = "unconfigured"
    """Nothing is loaded."""
    COLD = "cold"
    """No slot allocated; the group needs no power."""
    RESERVED = "reserved"
    """The slots of the group are allocated; it needs no power, its brakes are on."""
    ACTIVE = "active"
    """Power on, brakes of the group on."""
    MOTION = "motion"
    """Power on, brakes of the group off."""
    ESTOPPED = "estopped"
    """Power off and brakes on after an emergency stop; latched."""


class Event(StrEnum):
    """Requests to MCS, and events in MCS."""

    CONFIGURE = "configure"
    CLEANUP = "cleanup"
    RESERVE = "reserve"
    RELEASE = "release"
    RENEW = "renew"
    TAKE_OVER = "take_over"
    REPARTITION = "repartition"
    POWER_ON = "power_on"
    POWER_OFF = "power_off"
    ENABLE_MOTION = "enable_motion"
    DISABLE_MOTION = "disable_motion"
    MOVE = "move"
    STREAM = "stream"
    QUERY = "query"
    CANCEL = "cancel"
    PAUSE = "pause"
    RESUME = "resume"
    SET_SPEED = "set_speed"
    SET_GRIPPER = "set_gripper"
    SET_CONTROLLER = "set_controller"
    SET_PAYLOAD = "set_payload"
    SURROUND = "surround"
    PROTECTIVE_STOP = "protective_stop"
    ESTOP = "estop"
    RESET = "reset"


STATES: tuple[State, ...] = tuple(State)
"""Their numbers where there is room for a number only."""

POWERED = (State.ACTIVE, State.MOTION)
"""States in which a group needs power: it is on while any group is in one of them."""

TRANSITIONS = frozenset({Event.POWER_ON, Event.POWER_OFF, Event.ENABLE_MOTION, Event.DISABLE_MOTION})
"""Requests that change power and brakes of groups, over several ticks."""

ANYTIME = frozenset({Event.ESTOP, Event.PROTECTIVE_STOP, Event.PAUSE, Event.CANCEL, Event.RENEW, Event.SURROUND})
"""Requests that are heard while a transition is under way: whatever stops, heartbeats, and what is around."""


@dataclass(frozen=True)
class StateTransition:
    """A row of the table.

    Attributes:
        source: State before.
        event: Request.
        target: State after.
        condition: What must hold, in words; empty if nothing.
    """

    source: State
    event: Event
    target: State
    condition: str = ""


_FREE = "every slot answers, none is owned by another group"
_RESERVED = "the group is reserved"
_OWNER = "by the owner of the group"
_HOLDS = "by the owner of the group, whose lease holds"
_UNDER_WAY = "the goal is under way or waits"
_SAME = "reserved groups have the same joints in it, or go at rest to groups of the same owner"
_SAFE = "by the owner of the group; every brake holds"
_CARRIED = "by the owner of the group; gravity torque present before the brakes release"
_AT_REST = "by the owner of the group, or its lease has lapsed; goals end, at rest first"
_UNUSED = "by the owner of the group, or its lease has lapsed; power stays while another group needs it"
_LATCHED = "holds until the group is resumed, or an emergency stop is reset"
_JAWS = "by the driver of its arm, if that is reserved, or by a node that mcs.yaml names"
_LAW = "by the owner of the group, which has such a law"

TABLE: tuple[StateTransition, ...] = (
    StateTransition(State.UNCONFIGURED, Event.CONFIGURE, State.COLD, "configuration valid, testbed answers"),
    StateTransition(State.COLD, Event.CLEANUP, State.UNCONFIGURED),
    StateTransition(State.COLD, Event.RESERVE, State.RESERVED, _FREE),
    StateTransition(State.COLD, Event.REPARTITION, State.COLD, "there is such a preset"),
    StateTransition(State.COLD, Event.RESUME, State.COLD, "of all groups"),
    StateTransition(State.COLD, Event.PROTECTIVE_STOP, State.COLD, _LATCHED),
    StateTransition(State.COLD, Event.SURROUND, State.COLD),
    StateTransition(State.COLD, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.RESERVED, Event.RELEASE, State.COLD, _OWNER),
    StateTransition(State.RESERVED, Event.RENEW, State.RESERVED, "the owner has reserved a group"),
    StateTransition(State.RESERVED, Event.TAKE_OVER, State.RESERVED, _RESERVED),
    StateTransition(State.RESERVED, Event.REPARTITION, State.RESERVED, _SAME),
    StateTransition(State.RESERVED, Event.POWER_ON, State.ACTIVE, _SAFE),
    StateTransition(State.RESERVED, Event.SET_CONTROLLER, State.RESERVED, _LAW),
    StateTransition(State.RESERVED, Event.SET_PAYLOAD, State.RESERVED, _OWNER),
    StateTransition(State.RESERVED, Event.SET_SPEED, State.RESERVED, _OWNER),
    StateTransition(State.RESERVED, Event.RESUME, State.RESERVED, _HOLDS),
    StateTransition(State.RESERVED, Event.PROTECTIVE_STOP, State.RESERVED, _LATCHED),
    StateTransition(State.RESERVED, Event.SURROUND, State.RESERVED),
    StateTransition(State.RESERVED, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.ACTIVE, Event.ENABLE_MOTION, State.MOTION, _CARRIED),
    StateTransition(State.ACTIVE, Event.POWER_OFF, State.RESERVED, _UNUSED),
    StateTransition(State.ACTIVE, Event.RELEASE, State.COLD, f"{_OWNER}; power off first"),
    StateTransition(State.ACTIVE, Event.RENEW, State.ACTIVE, "the owner has reserved a group"),
    StateTransition(State.ACTIVE, Event.TAKE_OVER, State.ACTIVE, _RESERVED),
    StateTransition(State.ACTIVE, Event.REPARTITION, State.ACTIVE, _SAME),
    StateTransition(State.ACTIVE, Event.SET_GRIPPER, State.ACTIVE, _JAWS),
    StateTransition(State.ACTIVE, Event.CANCEL, State.ACTIVE, _UNDER_WAY),
    StateTransition(State.ACTIVE, Event.SET_CONTROLLER, State.ACTIVE, _LAW),
    StateTransition(State.ACTIVE, Event.SET_PAYLOAD, State.ACTIVE, _OWNER),
    StateTransition(State.ACTIVE, Event.SET_SPEED, State.ACTIVE, _OWNER),
    StateTransition(State.ACTIVE, Event.RESUME, State.ACTIVE, _HOLDS),
    StateTransition(State.ACTIVE, Event.PROTECTIVE_STOP, State.ACTIVE, _LATCHED),
    StateTransition(State.ACTIVE, Event.SURROUND, State.ACTIVE),
    StateTransition(State.ACTIVE, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.MOTION, Event.DISABLE_MOTION, State.ACTIVE, _AT_REST),
    StateTransition(State.MOTION, Event.POWER_OFF, State.RESERVED, f"{_AT_REST}, motion disabled"),
    StateTransition(State.MOTION, Event.RELEASE, State.COLD, f"{_OWNER}; goals end, power off first"),
    StateTransition(State.MOTION, Event.RENEW, State.MOTION, "the owner has reserved a group"),
    StateTransition(State.MOTION, Event.TAKE_OVER, State.MOTION, _RESERVED),
    StateTransition(State.MOTION, Event.REPARTITION, State.MOTION, _SAME),
    StateTransition(State.MOTION, Event.MOVE, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.STREAM, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.QUERY, State.MOTION, "a trajectory is followed at that time"),
    StateTransition(State.MOTION, Event.CANCEL, State.MOTION, _UNDER_WAY),
    StateTransition(State.MOTION, Event.PAUSE, State.MOTION, _RESERVED),
    StateTransition(State.MOTION, Event.RESUME, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.SET_SPEED, State.MOTION, _OWNER),
    StateTransition(State.MOTION, Event.SET_GRIPPER, State.MOTION, _JAWS),
    StateTransition(State.MOTION, Event.SET_CONTROLLER, State.MOTION, _LAW),
    StateTransition(State.MOTION, Event.SET_PAYLOAD, State.MOTION, _OWNER),
    StateTransition(State.MOTION, Event.PROTECTIVE_STOP, State.MOTION, f"decelerates on the path; {_LATCHED}"),
    StateTransition(State.MOTION, Event.SURROUND, State.MOTION),
    StateTransition(State.MOTION, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.ESTOPPED, Event.SURROUND, State.ESTOPPED),
    StateTransition(State.ESTOPPED, Event.RESET, State.COLD, "the cause is gone, nothing is broken; nothing moves"),
    StateTransition(State.ESTOPPED, Event.PROTECTIVE_STOP, State.ESTOPPED, _LATCHED),
    StateTransition(State.ESTOPPED, Event.ESTOP, State.ESTOPPED, "the first cause stays"),
)

RECOVER = "scripts/im recover"
"""The command that brings the machine back, as texts name it."""

UNCONFIGURED_MESSAGE = f"MCS is unconfigured; {RECOVER} configures it (transition configure on /mcs/change_state)"

_ROWS = {(row.source, row.event): row for row in TABLE}
_LIFECYCLE = {
    State.UNCONFIGURED: "unconfigured",
    State.COLD: "inactive",
    State.RESERVED: "inactive",
    State.ESTOPPED: "inactive",
    State.ACTIVE: "active",
    State.MOTION: "active",
}


def lifecycle_of(state: State) -> str:
    """Return the label of the ROS lifecycle state for ``state``: power on is *active*."""
    return _LIFECYCLE[state]


def highest(states: Iterable[State]) -> State:
    """Return the machine's state, the highest of the groups' states; cold if there are none."""
    return max(states, key=STATES.index, default=State.COLD)


def allows(state: State, event: Event) -> bool:
    """Whether the table has a row for ``event`` in ``state``."""
    return (state, event) in _ROWS


def allowed_in(state: State) -> tuple[Event, ...]:
    """Return requests with a row of the table in ``state``, in its order; surroundings are told in every state."""
    return tuple(row.event for row in TABLE if row.source is state and row.event is not Event.SURROUND)


def next_state(state: State, event: Event, group: str = "", cause: str = "") -> State:
    """Return the state after ``event``.

    Args:
        state: State of a group, or of the machine.
        event: What is asked for.
        group: Whose state it is, for the message; empty: the machine's.
        cause: Why it is in this state, though nobody asked for it; or empty.

    Raises:
        StateError: The table has no such row; the message names state, cause, request and what would be allowed.
    """
    row = _ROWS.get((state, event))
    if row is not None:
        return row.target
    if state is State.UNCONFIGURED:
        raise StateError(UNCONFIGURED_MESSAGE, state=state.value, request=event.value)
    allowed = [e.value for e in allowed_in(state)]
    hint = f" ({RECOVER} does it)" if state is State.ESTOPPED else ""
    whose = f" of group '{group}'" if group else ""
    why = f"; the cause of this state: {cause}" if cause else ""
    raise StateError(
        f"{event.value}{whose} is refused in state {state.value}; allowed here: {', '.join(allowed)}{hint}{why}",
        state=state.value,
        request=event.value,
        allowed=allowed,
    )
