"""The servo's end of the testbed link."""

from im_cell.link.end import LinkEnd
from im_cell.link.values import Drive, Faults, Measured
from im_core.errors import LinkError
from im_core.processes.procfs import ProcessId


class ServoEnd(LinkEnd):
    """Servo end of the link: reads the measured state of each tick and answers with a command."""

    _pid = 0  # of the servo that this end has attached; 0: none

    def attach_servo(self, pid: int) -> None:
        """Attach a servo from the next tick on; a servo already attached still answers the present tick.

        Raises:
            LinkError: Another living servo is attached, or ``pid`` does not run.
        """
        view, process = self._shared.view, ProcessId.of(pid)
        if process.start < 0:
            raise LinkError(f"process {pid} cannot be the servo: it does not run", pid=pid)
        present = ProcessId(int(view["servo_pid"]), int(view["servo_start"]))
        if present.pid != pid and present.alive():
            raise LinkError(f"the testbed already has a servo, process {present.pid}", pid=present.pid)
        self._pid = pid
        if present == process:
            return
        self._shared.state.drain()
        view["servo_start"][()] = process.start
        view["servo_pid"][()] = pid
        self._shared.wake.post()

    def wait_state(self, timeout_s: float) -> bool:
        """Wait for the start of a tick.

        Returns:
            True if a tick waits for :meth:`write_command`, False after ``timeout_s`` [s] without one.

        Raises:
            LinkError: Physics is gone, or has declared this servo gone: no tick will come.
        """
        if self._shared.state.wait(timeout_s):
            return True
        if not self._shared.block.owner_alive():
            raise LinkError("the testbed's physics process is gone")
        self._require_attached()
        return False

    def read_state(self) -> Measured:
        """The measured state of the newest tick; never torn, from any process.

        Raises:
            LinkError: Physics died while it wrote the state, or has declared the servo gone that reads it: power and
                brakes are not as this servo wants them, and that is why.
        """
        view = self._shared.view
        sequence = view["sequence"]
        for _ in range(100_000):
            before = int(sequence)
            tick = int(view["tick"])
            q, power, *others = self._shared.sensed.get()
            if before % 2 == 0 and int(sequence) == before:
                self._require_attached()
                return Measured(tick, tick * self._shared.period_ns, q, bool(power), *others)
        raise LinkError("the testbed's physics process stopped in the middle of writing the state")

    def faults(self) -> Faults:
        """Return the faults reported by the testbed, as by the drives of a robot."""
        return self._shared.faults()

    def write_command(self, command: Drive) -> None:
        """Answer the current tick.

        Raises:
            LinkError: Physics has declared this servo gone, whether another one is attached since or not;
                :meth:`attach_servo` again.
        """
        view = self._shared.view
        if not self._pid or int(view["servo_pid"]) != self._pid:
            raise self._gone()
        self._shared.commanded.put(command)
        view["command_tick"][()] = view["tick"]
        self._shared.command.post()

    def detach_servo(self) -> None:
        """Leave the handshake; the testbed engages brakes and cuts power. Harmless when another one is attached."""
        view = self._shared.view
        pid, self._pid = self._pid, 0
        if int(view["servo_pid"]) != pid:
            return
        view["servo_pid"][()] = 0
        view["command_wants_time"][()] = False
        self._shared.command.post()

    def _require_attached(self) -> None:
        """Raise once, if the attached servo was declared gone."""
        if self._pid and int(self._shared.view["servo_pid"]) != self._pid:
            raise self._gone()

    def _gone(self) -> LinkError:
        """Return the error for a lost servo: raised once for a reader, for a writer until the next attachment."""
        self._pid = 0
        present = int(self._shared.view["servo_pid"])
        other = f"; process {present} is its servo now" if present else ""
        return LinkError(f"the testbed declared the servo gone before tick {self.tick}{other}")
