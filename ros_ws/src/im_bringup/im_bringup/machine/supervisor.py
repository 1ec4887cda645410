"""``supervisor``: the parent of the bootstrap. Where that is killed, the whole machine is started again.

The tasks of a host end with the bootstrap that started them. A new bootstrap starts them all anew; their journals are
kept, so that the nets go on where they were. What ends with an exit code has ended on purpose, or would end so again;
it is not started again.
"""

import signal
import sys
from dataclasses import replace
from types import FrameType

from im_bringup.machine import leftovers
from im_bringup.machine import record as machine
from im_core import clock
from im_core.process import ChildProcess
from im_core.shm import ProcessId

#: How long the tasks of a dead bootstrap may take to end by themselves [s].
_ORDERLY_S = 4.0
_POLL_S = 0.05


class BootstrapKeeper:
    """The supervisor: runs a bootstrap, and another one when that is killed after the machine was ready.

    Args:
        argv: Program and arguments of the bootstrap.
    """

    def __init__(self, argv: list[str]) -> None:
        self._argv = argv
        self._child: ChildProcess | None = None
        self._stopped: signal.Signals | None = None

    def stop(self, number: int, _: FrameType | None = None) -> None:
        """Pass a signal on and end with the bootstrap; fit for a signal handler."""
        self._stopped = signal.Signals(number)
        if self._child is not None:
            self._child.send_signal(self._stopped)

    def run(self) -> int:
        """Run until a bootstrap ends by itself; its exit code, 1 if it was killed and is not started again."""
        while self._stopped is None:
            self._child = ChildProcess(self._argv, death_signal=None)
            if self._stopped is not None:  # while it was being started
                self._child.send_signal(self._stopped)
            while (code := self._child.poll()) is None:
                clock.sleep(_POLL_S)
            if code >= 0:
                return code
            record = machine.read()
            if record is None or record.state != machine.READY:
                return 1
            sentence = f"the bootstrap was killed by {signal.Signals(-code).name}; the machine is started again"
            print(f"[supervisor]: {sentence}", flush=True)
            me = ProcessId.current()
            record = replace(record, pid=me.pid, start=me.start, state=machine.STARTING, missing=[sentence])
            machine.write(record)
            self._clear()
            machine.write(record)
        return 1

    def _clear(self) -> None:
        """Let the tasks of a dead bootstrap end, and remove what they leave in shared memory, the record too."""
        deadline = clock.monotonic() + _ORDERLY_S
        while (left := leftovers.processes()) and clock.monotonic() < deadline and self._stopped is None:
            clock.sleep(_POLL_S)
        leftovers.kill(left, timeout_s=2.0)
        leftovers.remove_shared_memory()


def main() -> int:
    """Run the command: a bootstrap and its arguments."""
    supervisor = BootstrapKeeper(sys.argv[1:])
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, supervisor.stop)
    return supervisor.run()


if __name__ == "__main__":
    sys.exit(main())
