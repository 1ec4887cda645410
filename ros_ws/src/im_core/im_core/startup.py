"""Synchronised start-up (paper, section 3): its phases, and the topics by which bootstrap and tasks speak of them."""

from enum import IntEnum

PHASE_TOPIC = "/im/phase"
STATUS_TOPIC = "/im/task_status"


class StartupPhase(IntEnum):
    """What the bootstrap asks of all tasks, as on :data:`PHASE_TOPIC`."""

    LOAD = 0
    CONFIGURE = 1
    START = 2
    SHUTDOWN = 3
