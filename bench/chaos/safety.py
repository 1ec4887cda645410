"""Watches the arms in the testbed's own memory, whoever has died: no leap, and rest where rest is due."""

import threading
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
from numpy.typing import NDArray

from im_cell.link import ControlState, HostEnd
from im_cell.robot import load_cell
from im_core import clock, names
from im_core.errors import LinkError

#: How soon after a fault that takes the control away all joints must rest [s] of testbed time; what counts as rest
#: [rad/s, m/s].
REST_S, REST = 0.5, 0.01
#: How far above its limit a velocity may be before it is a leap: limits hold for setpoints, following has its error.
MARGIN = 1.2
_POLL_S, _AGAIN_S = 0.005, 0.1


class Rest:
    """The rule for arms that have lost their control: they come to rest, and stay there until a servo takes over.

    Testbed time stands still while nobody wants any, and what comes first then is the next command: its motion, under
    another servo or after the same one has come back, is none of a fault before it.

    Args:
        control: Who had the control when the fault came.
        joints: Names of the joints.
        period_s: Of a tick [s].
    """

    def __init__(self, control: ControlState, joints: Sequence[str], period_s: float) -> None:
        self._from, self._joints, self._period_s = control, joints, period_s
        #: Whether another servo has the control, or this one has it anew.
        self.over = False

    def finding(self, control: ControlState, v: NDArray[np.float64]) -> str:
        """What is unsafe, as a sentence; empty if nothing.

        Args:
            control: Who has the control now.
            v: True velocities of all joints, shape (n,) [rad/s or m/s].
        """
        if control.servo and (control.servo, control.losses) != (self._from.servo, self._from.losses):
            self.over = True
        since_s = (control.tick - self._from.tick) * self._period_s
        if self.over or since_s <= REST_S or np.abs(v).max() <= REST:
            return ""
        rank = int(np.abs(v).argmax())
        return f"{since_s:.2f} s after the fault {self._joints[rank]} still moves, {v[rank]:.3f}"


class Uncontrolled:
    """The rule for a testbed without a servo: from the second tick on the power is off and every brake holds."""

    def __init__(self) -> None:
        self._gone_at: int | None = None

    def finding(self, control: ControlState) -> str:
        """What is unsafe, as a sentence; empty if nothing."""
        if control.servo:
            self._gone_at = None
            return ""
        if self._gone_at is None:
            self._gone_at = control.tick
        if control.tick <= self._gone_at + 1 or (control.braked and not control.power):
            return ""
        power, brakes = "on" if control.power else "off", "on" if control.braked else "off"
        return f"{control.tick - self._gone_at} ticks without a servo: power {power}, brakes {brakes}"


class Watch:
    """A thread that reads positions and velocities of all joints; leaves them alone."""

    def __init__(self) -> None:
        cell = load_cell()
        self._names = cell.joint_names
        self._limits = MARGIN * np.array([joint.limits.velocity for joint in cell.joints])
        self._findings: list[str] = []
        self._rest: Rest | None = None
        self._rest_due = False
        self._uncontrolled = Uncontrolled()
        self._running = True
        self._thread = threading.Thread(target=self._run, name="safety", daemon=True)

    def expect_rest(self) -> None:
        """From half a second of testbed time after now on, everything must rest."""
        self._rest_due = True

    def take_findings(self) -> list[str]:
        """What was unsafe since the last call, as sentences."""
        found, self._findings = self._findings, []
        self._rest, self._rest_due = None, False
        return found

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._running = False
        self._thread.join()

    def _run(self) -> None:
        while self._running:
            try:
                with ExitStack() as stack:
                    testbed = stack.enter_context(HostEnd.attach(names.instance(), 0.0))
                    while self._running and testbed.physics_alive():
                        control, v = testbed.read_control(), testbed.read_truth().v
                        if testbed.read_control() == control:  # velocities and control are of one tick
                            self._look(control, testbed.period_s, v)
                        clock.sleep(_POLL_S)
            except LinkError:  # it is being started again
                pass
            self._rest, self._rest_due, self._uncontrolled = None, False, Uncontrolled()  # another testbed, at rest
            clock.sleep(_AGAIN_S)

    def _look(self, control: ControlState, period_s: float, v: NDArray[np.float64]) -> None:
        fast = np.flatnonzero(np.abs(v) > self._limits)
        if fast.size:
            told = ", ".join(f"{self._names[rank]} {v[rank]:.2f}" for rank in fast)
            self._findings.append(f"faster than its limit: {told}")
        if self._rest_due:
            self._rest, self._rest_due = Rest(control, self._names, period_s), False
        found = [self._uncontrolled.finding(control)]
        if self._rest is not None:
            found.append(self._rest.finding(control, v))
        self._findings += [finding for finding in found if finding]
