"""Channel driver of the simulated testbed, over shared memory and semaphores."""

import os

import numpy as np

from im_cell.link import ServoEnd, StopEnd
from im_core import clock
from im_core.errors import LinkError
from im_mcs.testbed.driver import Drive, Measured, PowerReading, ReportedFault

_POLL_S = 20e-6
_LOOK_S = 0.1


class SimulatedDriver:
    """The servo's end of the testbed link.

    Args:
        instance: Which machine on this host.
        timeout_s: How long :meth:`connect` waits for the testbed, wall time [s].
    """

    time_on_demand = True

    def __init__(self, instance: str, timeout_s: float) -> None:
        self._link = ServoEnd.attach(instance, timeout_s)
        link = self._link
        self.n_joints, self.n_grippers, self.n_wrenches = link.n_joints, link.n_grippers, link.n_wrenches
        self.period_s = self._link.period_s
        self.wall_period_s = self._link.wall_period_s

    def connect(self) -> None:
        """Take part in the handshake; with a new testbed, if the one before is gone.

        Raises:
            LinkError: There is no testbed, another servo takes part, or the new testbed ticks at another rate.
        """
        if not self._link.physics_alive():
            link = ServoEnd.attach(self._link.instance, 0.0)
            if link.period_s != self.period_s:
                link.close()
                raise LinkError(f"the new testbed ticks every {link.period_s:g} s, the servo every {self.period_s:g} s")
            self._link.close()
            self._link = link
            self.wall_period_s = link.wall_period_s
        self._link.attach_servo(os.getpid())

    def wait(self, timeout_s: float) -> bool:
        """Wait for a tick to begin.

        Raises:
            LinkError: The physics process is gone.
        """
        return self._link.wait_state(timeout_s)

    def time_asked(self) -> bool:
        """Whether somebody has asked for time beyond the present tick."""
        return self._link.time_asked()

    @property
    def hardware_pid(self) -> int:
        """The physics process."""
        return self._link.physics_pid

    def read(self) -> Measured:
        """Encoder readings, power, brakes and grippers of the newest tick."""
        return self._link.read_state()

    def write(self, drive: Drive) -> None:
        """Answer the tick.

        Raises:
            LinkError: The testbed has declared this servo gone.
        """
        self._link.write_command(drive)

    def faults(self) -> list[ReportedFault]:
        """Return the injected faults."""
        faults = self._link.faults()
        kinds = ("encoder_nan", "encoder_frozen", "brake_stuck", "brake_open")
        broken = [ReportedFault(kind, int(joint)) for kind in kinds for joint in np.flatnonzero(getattr(faults, kind))]
        return broken + [ReportedFault("power_loss")] * faults.power_loss

    @staticmethod
    def stop_circuit(instance: str) -> "SimulatedStop":
        """The testbed's emergency stop."""
        return SimulatedStop(instance)

    def after_tick(self, tick: int) -> None:
        """Wait until physics has completed ``tick``; takes a fraction of a millisecond on an idle computer.

        There is no time-out while physics lives: who hears of a tick before its end may ask for time too early, and
        the run would no longer repeat.
        """
        look = clock.monotonic() + _LOOK_S
        while self._link.tick <= tick:
            clock.sleep(_POLL_S)
            if clock.monotonic() > look:
                if not self._link.physics_alive():
                    return
                look += _LOOK_S

    def close(self) -> None:
        """Leave the handshake; the testbed brakes without a driver."""
        self._link.detach_servo()
        self._link.close()


class SimulatedStop:
    """Emergency stop of the simulated testbed running at the use."""

    def __init__(self, instance: str) -> None:
        self._instance = instance

    def cut(self) -> None:
        """Power off and brakes on, until :meth:`restore`.

        Raises:
            LinkError: There is no testbed.
        """
        with StopEnd.attach(self._instance, 0.0) as end:
            end.cut()

    def restore(self) -> None:
        """Let the servo switch power on again.

        Raises:
            LinkError: There is no testbed.
        """
        with StopEnd.attach(self._instance, 0.0) as end:
            end.restore()

    def is_cut(self) -> bool:
        """Return whether the circuit is cut.

        Raises:
            LinkError: There is no testbed.
        """
        with StopEnd.attach(self._instance, 0.0) as end:
            return end.is_cut

    def reading(self) -> PowerReading:
        """Read power and brakes of the newest tick.

        Raises:
            LinkError: There is no testbed.
        """
        with StopEnd.attach(self._instance, 0.0) as end:
            return PowerReading(*end.reading())
