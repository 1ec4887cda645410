"""State manager (paper, section 4 and Figure 7): states, allocation of slots, order of transitions."""

from im_mcs.state.reservation import Reservations
from im_mcs.state.table import (
    POWERED,
    TABLE,
    UNCONFIGURED_MESSAGE,
    Event,
    State,
    StateTransition,
    lifecycle_of,
    next_state,
)

__all__ = [
    "POWERED",
    "TABLE",
    "UNCONFIGURED_MESSAGE",
    "Event",
    "Reservations",
    "State",
    "StateTransition",
    "lifecycle_of",
    "next_state",
]
