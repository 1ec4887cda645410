"""Processes of the machine of the current ROS domain: membership, and the one way to signal a member by pid."""

import os
import signal
from pathlib import Path

from im_bringup.tasks.agent import MARKER
from im_core import names
from im_core.processes.procfs import ProcessId


def is_member(process: ProcessId) -> bool:
    """Check whether a process runs, is the user's own, and was started as part of the current ROS domain's machine.

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
    """Signal a process, but only a member.

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
