"""Synchronised start-up (paper, section 3): the phases, and the topics of the start-up."""

import hashlib
import os
import re
from collections.abc import Iterable
from enum import IntEnum

PHASE_TOPIC = "/im/phase"
STATUS_TOPIC = "/im/task_status"

#: Longest wait for the machine to be ready unless ``start`` is told another [s]; where that is said once for all starts
#: of a slow computer, and where the processes of a machine find it.
START_TIMEOUT_S = 60.0
START_TIMEOUT = "IM_START_TIMEOUT_S"
_SHARE = 0.8

#: Where the processes of a machine find that it is started with nets that are not proved, see ``start --unproved``.
UNPROVED = "IM_UNPROVED"


def patience_s() -> float:
    """How long a part of the machine waits at start for another one to be there [s].

    A share of the time that ``start --timeout`` gives to the whole machine, so that who waited in vain says for what
    before the start is given up. Every wait of the start-up takes it; a busy computer then makes the start late, and
    needs one number to be changed.
    """
    return _SHARE * start_timeout_s()


def start_timeout_s() -> float:
    """Return the longest time for the start of the machine with the present process [s]."""
    return float(os.environ.get(START_TIMEOUT) or START_TIMEOUT_S)


def unproved_allowed() -> bool:
    """Return whether nets with a check undecided in time may run; a refused net never may."""
    return os.environ.get(UNPROVED) == "1"


_NETS = "nets: "
_NET = re.compile("[A-Za-z_][A-Za-z0-9_]{0,199}")


def nets_sentence(nets: Iterable[str]) -> str:
    """Return the sentence of a configured task naming the nets in use; START waits for the nets' descriptions."""
    names = ", ".join(nets)
    return f"{_NETS}{names}" if names else ""


def net_digest(text: str) -> str:
    """The digest of a net file: the description on DDS counts only if the task has reported the same digest."""
    return hashlib.sha256(text.encode(errors="replace")).hexdigest()


def nets_told(detail: str) -> tuple[str, ...]:
    """Return the nets of a task in the text of :func:`nets_sentence`; none in any other text."""
    names = detail.removeprefix(_NETS).split(", ") if detail.startswith(_NETS) else []
    return tuple(name for name in names if _NET.fullmatch(name))


class StartupPhase(IntEnum):
    """Phase ordered by the bootstrap for all tasks; also on :data:`PHASE_TOPIC`, for information only."""

    LOAD = 0
    CONFIGURE = 1
    START = 2
    SHUTDOWN = 3
