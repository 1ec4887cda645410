"""``stop``: take the machine of the current ROS domain down, in any state."""

import argparse
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from im_bringup.machine import leftovers, run_state
from im_bringup.machine import machine_state as machine
from im_bringup.machine.interrupts import ignore_interrupts
from im_bringup.machine.members import is_member, signal_member
from im_bringup.machine.start_mark import end_start
from im_core import clock, names, output, unfinished_commands
from im_core.errors import DataError, LinkError
from im_core.processes import host_record
from im_core.processes.process import last_words

#: The bootstrap's own ordered shutdown takes less than this, and its supervisor notices its end [s].
_ORDERLY_S = 4.8


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="stop",
        description="Stop the machine of this ROS domain and remove what a killed one left behind; takes 5 s at most "
        "on a computer that has a processor for it. On a host of `start --host`: stop its agent and the tasks there.",
        epilog="Exit codes: 0 nothing runs any more, 1 something could not be ended (said what).",
    )
    parser.parse_args()
    ignore_interrupts()
    if end_start():
        output.say("stop: a start was under way, and has ended")
    return stop(output.say)


def stop(say: Callable[[str], None]) -> int:
    """Stop the machine.

    Returns:
        0 if nothing is left, else 1.
    """
    began = clock.monotonic()
    try:
        record = machine.read()
    except (DataError, LinkError):  # what is no record, or belongs to another user, is told of at the end
        record = None
    ran = record is not None and is_member(record.process)
    agent = None if ran else host_record.read()
    if agent is not None and signal_member(agent.process, signal.SIGINT):
        say(f"stop: the agent of host {agent.host} ends with its tasks; the machine of the first host lacks them then")
        ran = True
        leftovers.await_end(_ORDERLY_S)
    elif record is not None and ran:
        signal_member(record.process, signal.SIGINT)
        leftovers.await_end(_ORDERLY_S)
    elif record is not None and record.alive:
        say(f"stop: the record names process {record.pid}, which is not of this machine and is left alone")
    if ran and record is not None and record.state == machine.READY:
        run_state.end(Path(record.run_dir))
    if ran and record is not None and (interrupted := unfinished_commands.noted(Path(record.run_dir))):
        say(f"stop: interrupted: {', '.join(map(str, interrupted))}; the next start brings them back paused")
    found, remaining = leftovers.end_all()
    removed = leftovers.remove_shared_memory()
    if others := leftovers.of_others():
        output.complain(f"stop: {leftovers.foreign_sentence(others)}")
        return 1
    if remaining:
        pids = ", ".join(str(process.pid) for process in remaining)
        output.complain(f"stop: processes {pids} could not be ended")
        return 1
    say(_summary(ran, len(found), len(removed), clock.monotonic() - began))
    return 0


def _summary(ran: bool, killed: int, removed: int, seconds: float) -> str:
    if not ran and not killed and not removed:
        return f"stop: no machine runs in ROS domain {machine.domain()}"
    parts = ["all tasks ended in order" if ran and not killed else ""]
    if killed:
        parts.append(f"{killed} processes had to be killed")
    if removed and not ran:
        parts.append(f"{removed} files of a killed machine removed from /dev/shm")
    return f"stop: {', '.join(part for part in parts if part)}; took {seconds:.1f} s"


def bootstrap_words() -> str:
    """The last line of the bootstrap's log."""
    return last_words(names.run_dir() / "log" / "bootstrap.log") or "it said nothing"


if __name__ == "__main__":
    sys.exit(main())
