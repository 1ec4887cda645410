"""Synchronised start-up (paper, section 3): its phases, and the topics by which bootstrap and tasks speak of them."""

import os
from enum import IntEnum

PHASE_TOPIC = "/im/phase"
STATUS_TOPIC = "/im/task_status"

#: Longest wait for the machine to be ready unless ``start`` is told another [s], and where its processes find it.
START_TIMEOUT_S = 60.0
START_TIMEOUT = "IM_START_TIMEOUT_S"
_SHARE = 0.8


def patience_s() -> float:
    """How long a part of the machine waits at start for another one to be there [s].

    A share of the time that ``start --timeout`` gives to the whole machine, so that who waited in vain says for what
    before the start is given up. Every wait of the start-up takes it; a busy computer then makes the start late, and
    needs one number to be changed.
    """
    return _SHARE * float(os.environ.get(START_TIMEOUT) or START_TIMEOUT_S)


class StartupPhase(IntEnum):
    """What the bootstrap asks of all tasks, as on :data:`PHASE_TOPIC`."""

    LOAD = 0
    CONFIGURE = 1
    START = 2
    SHUTDOWN = 3
