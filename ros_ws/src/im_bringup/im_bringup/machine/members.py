"""The processes of the machine of this ROS domain: who belongs to it, and the one way to signal one by its number."""

import os
import signal
from pathlib import Path

from im_bringup.tasks.agent import MARKER
from im_core import names
from im_core.procfs import ProcessId


def is_member(process: ProcessId) -> bool:
    """Whether this very process runs, is of this user, and was started as part of the machine of this ROS domain.

    The mark is in the environment that the kernel keeps of its start: neither a record that somebody wrote by hand nor
    a number that the kernel uses again makes a stranger one.
    """
    folder = Path("/proc") / str(process.pid)
    try:
        mine = folder.stat().st_uid == os.geteuid()
        environment = (folder / "environ").read_bytes().split(b"\0")
    except OSError:
        return False
    return mine and f"{MARKER}={names.instance()}".encode() in environment and process.alive()


def signal_member(process: ProcessId, number: signal.Signals) -> bool:
    """Signal a process if it is a member.

    Args:
        process: The process.
        number: What to send.

    Returns:
        Whether it was sent.
    """
    try:
        handle = os.pidfd_open(process.pid)
    except OSError:  # it has ended
        return False
    try:
        # the handle was there before the look: what is looked at is what gets the signal
        if not is_member(process):
            return False
        signal.pidfd_send_signal(handle, number)
    except ProcessLookupError:
        return False
    finally:
        os.close(handle)
    return True
