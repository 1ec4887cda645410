"""The state table: which request is allowed in which state, and where it leads (paper, Figure 7)."""

from dataclasses import dataclass
from enum import StrEnum

from im_core.errors import StateError


class State(StrEnum):
    """States of MCS; all but the first are the paper's."""

    UNCONFIGURED = "unconfigured"
    """Nothing is loaded."""
    COLD = "cold"
    """Power off, no slot reserved."""
    RESERVED = "reserved"
    """Power off, the slots of at least one group allocated."""
    ACTIVE = "active"
    """Power on, brakes on."""
    MOTION = "motion"
    """Power on, brakes of the reserved groups off."""
    ESTOPPED = "estopped"
    """Power off and brakes on after an emergency stop; latched."""


class Event(StrEnum):
    """What may be asked of MCS, or happen to it."""

    CONFIGURE = "configure"
    CLEANUP = "cleanup"
    RESERVE = "reserve"
    RELEASE = "release"
    RELEASE_LAST = "release the last group"
    RENEW = "renew"
    TAKE_OVER = "take_over"
    REPARTITION = "repartition"
    POWER_ON = "power_on"
    POWER_OFF = "power_off"
    ENABLE_MOTION = "enable_motion"
    DISABLE_MOTION = "disable_motion"
    MOVE = "move"
    STREAM = "stream"
    CANCEL = "cancel"
    PAUSE = "pause"
    RESUME = "resume"
    SET_SPEED = "set_speed"
    SET_GRIPPER = "set_gripper"
    SET_CONTROLLER = "set_controller"
    SET_PAYLOAD = "set_payload"
    PROTECTIVE_STOP = "protective_stop"
    ESTOP = "estop"
    RESET = "reset"


STATES: tuple[State, ...] = tuple(State)
"""Their numbers where there is room for a number only."""

ANYTIME = frozenset({Event.ESTOP, Event.RENEW})
"""Requests that are heard while a transition is under way."""


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
_SAME = "the reserved groups have the same joints in it"
_CARRIED = "gravity torque present before the brakes release"
_LAW = "by the owner of the group, which has such a law"

TABLE: tuple[StateTransition, ...] = (
    StateTransition(State.UNCONFIGURED, Event.CONFIGURE, State.COLD, "configuration valid, testbed answers"),
    StateTransition(State.COLD, Event.CLEANUP, State.UNCONFIGURED),
    StateTransition(State.COLD, Event.RESERVE, State.RESERVED, _FREE),
    StateTransition(State.COLD, Event.REPARTITION, State.COLD, "there is such a preset"),
    StateTransition(State.COLD, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.RESERVED, Event.RESERVE, State.RESERVED, _FREE),
    StateTransition(State.RESERVED, Event.RELEASE, State.RESERVED, _OWNER),
    StateTransition(State.RESERVED, Event.RELEASE_LAST, State.COLD, _OWNER),
    StateTransition(State.RESERVED, Event.RENEW, State.RESERVED, "the owner has reserved a group"),
    StateTransition(State.RESERVED, Event.TAKE_OVER, State.RESERVED, _RESERVED),
    StateTransition(State.RESERVED, Event.REPARTITION, State.RESERVED, _SAME),
    StateTransition(State.RESERVED, Event.POWER_ON, State.ACTIVE, "power on, brakes on; measured state valid"),
    StateTransition(State.RESERVED, Event.SET_CONTROLLER, State.RESERVED, _LAW),
    StateTransition(State.RESERVED, Event.SET_PAYLOAD, State.RESERVED, _OWNER),
    StateTransition(State.RESERVED, Event.SET_SPEED, State.RESERVED, _OWNER),
    StateTransition(State.RESERVED, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.ACTIVE, Event.ENABLE_MOTION, State.MOTION, _CARRIED),
    StateTransition(State.ACTIVE, Event.POWER_OFF, State.RESERVED),
    StateTransition(State.ACTIVE, Event.RENEW, State.ACTIVE, "the owner has reserved a group"),
    StateTransition(State.ACTIVE, Event.TAKE_OVER, State.ACTIVE, _RESERVED),
    StateTransition(State.ACTIVE, Event.SET_GRIPPER, State.ACTIVE),
    StateTransition(State.ACTIVE, Event.CANCEL, State.ACTIVE, _UNDER_WAY),
    StateTransition(State.ACTIVE, Event.SET_CONTROLLER, State.ACTIVE, _LAW),
    StateTransition(State.ACTIVE, Event.SET_PAYLOAD, State.ACTIVE, _OWNER),
    StateTransition(State.ACTIVE, Event.SET_SPEED, State.ACTIVE, _OWNER),
    StateTransition(State.ACTIVE, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.MOTION, Event.DISABLE_MOTION, State.ACTIVE, "at rest first"),
    StateTransition(State.MOTION, Event.RENEW, State.MOTION, "the owner has reserved a group"),
    StateTransition(State.MOTION, Event.TAKE_OVER, State.MOTION, _RESERVED),
    StateTransition(State.MOTION, Event.MOVE, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.STREAM, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.CANCEL, State.MOTION, _UNDER_WAY),
    StateTransition(State.MOTION, Event.PAUSE, State.MOTION, _RESERVED),
    StateTransition(State.MOTION, Event.RESUME, State.MOTION, _HOLDS),
    StateTransition(State.MOTION, Event.SET_SPEED, State.MOTION, _OWNER),
    StateTransition(State.MOTION, Event.SET_GRIPPER, State.MOTION),
    StateTransition(State.MOTION, Event.SET_CONTROLLER, State.MOTION, _LAW),
    StateTransition(State.MOTION, Event.SET_PAYLOAD, State.MOTION, _OWNER),
    StateTransition(State.MOTION, Event.PROTECTIVE_STOP, State.MOTION, "decelerates on the path and holds"),
    StateTransition(State.MOTION, Event.ESTOP, State.ESTOPPED),
    StateTransition(State.ESTOPPED, Event.RESET, State.COLD, "the cause is gone, nothing is broken; nothing moves"),
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
    """Label of the ROS lifecycle state that goes with ``state``: power on is *active*."""
    return _LIFECYCLE[state]


def allowed_in(state: State) -> tuple[Event, ...]:
    """Requests that the table has a row for in ``state``, in the order of the table."""
    return tuple(row.event for row in TABLE if row.source is state and row.event is not Event.RELEASE_LAST)


def next_state(state: State, event: Event) -> State:
    """State that ``event`` leads to.

    Raises:
        StateError: The table has no such row; the message names state, request and what would be allowed.
    """
    row = _ROWS.get((state, event))
    if row is not None:
        return row.target
    if state is State.UNCONFIGURED:
        raise StateError(UNCONFIGURED_MESSAGE, state=state.value, request=event.value)
    allowed = [e.value for e in allowed_in(state)]
    hint = f" ({RECOVER} does it)" if state is State.ESTOPPED else ""
    raise StateError(
        f"{event.value} is refused in state {state.value}; allowed here: {', '.join(allowed)}{hint}",
        state=state.value,
        request=event.value,
        allowed=allowed,
    )
