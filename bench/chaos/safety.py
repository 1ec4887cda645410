"""Watch the arms in the testbed's own memory, whatever has died: no leap, and stops as decelerations and brakes give.

The model of the arms here is that of the cell's parameters, not that of the testbed.
"""

import threading
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.link import ControlState, HostEnd, TrueState
from im_cell.robot import Cell, load_cell, urdf
from im_core import clock, names
from im_core.errors import LinkError

#: How soon after a fault that takes the control away a servo that keeps the power must have all joints at rest [s] of
#: testbed time; what counts as rest [rad/s, m/s].
REST_S, REST = 0.5, 0.01
#: Share of the energy, and energy [J], by which the brakes may seem to have done more work than there was to do.
SHARE, ENERGY_J = 0.05, 0.05
#: Ticks by which brakes may seem late: a state is read between two ticks.
LATE_TICKS = 2
#: How far above its limit a velocity may be before it is a leap: limits hold for setpoints, following has its error.
#: Without power there are no setpoints: until the brakes hold, gravity drives, and :class:`Braking` judges.
MARGIN = 1.2
_POLL_S, _AGAIN_S = 0.005, 0.1


class Rest:
    """The rule for arms that have lost their client but not their power: they decelerate, and rest.

    Testbed time stands still while nobody wants any, and what comes first then is the next command: its motion, under
    another servo or after the same one has come back, is none of a fault before it. Without power, :class:`Braking`
    judges.

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
        if self.over or not control.power or since_s <= REST_S or np.abs(v).max() <= REST:
            return ""
        rank = int(np.abs(v).argmax())
        return f"{since_s:.2f} s after the fault {self._joints[rank]} still moves, {v[rank]:.3f}"


class Braking:
    """The rule for arms without power: brakes engage after their delay, and the travel is what they give.

    With the kinetic and potential energy E(q, v) of arms and rotors and the brake torques b, every stop keeps

        sum_i b_i |q_i - q0_i| <= E(q0, v0) - E(q, v)

    from the state (q0, v0) on in which all brakes hold: brakes take energy, nothing gives any. A motor that still
    drives, or a brake weaker than stated, passes that bound. Until the brakes hold, E does not grow.

    Args:
        cell: Stated torques and delay of the brakes, and the arms.
        period_s: Of a tick [s].
    """

    def __init__(self, cell: Cell, period_s: float) -> None:
        self._names, self._brakes = cell.joint_names, cell.per_joint("brake")
        self._delay_ticks = round(cell.brakes.delay / period_s) + LATE_TICKS
        self._model = pin.buildModelFromXML(urdf(cell, shapes=False))
        self._model.gravity.linear = np.array([0.0, 0.0, -cell.gravity])
        self._model.armature = cell.per_joint("rotor_inertia")
        self._data = self._model.createData()
        self._off: tuple[int, float] | None = None
        self._held: tuple[NDArray[np.float64], float] | None = None

    def energy(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> float:
        """Kinetic and potential energy [J] at ``q`` with ``v``, shape (n,) each."""
        potential = pin.computePotentialEnergy(self._model, self._data, q)
        inertia = pin.crba(self._model, self._data, q)
        return float(potential + 0.5 * v @ (np.triu(inertia) + np.triu(inertia, 1).T) @ v)

    def finding(self, control: ControlState, q: NDArray[np.float64], v: NDArray[np.float64]) -> str:
        """What is unsafe, as a sentence; empty if nothing. Arguments as of :meth:`energy`, and who has the control."""
        if control.power:
            self._off = self._held = None
            return ""
        energy = self.energy(q, v)
        if self._off is None:
            self._off = control.tick, energy
        since, before = self._off
        if not control.braked:
            self._held = None
            if control.tick - since > self._delay_ticks:
                return f"{control.tick - since} ticks without power, and not every brake holds"
            return f"{energy - before:.2f} J came from nowhere, without power" * (energy - before > ENERGY_J)
        if self._held is None:
            self._held = q.copy(), energy
        q0, energy0 = self._held
        work = self._brakes * np.abs(q - q0)
        if work.sum() <= (1.0 + SHARE) * max(0.0, energy0 - energy) + ENERGY_J:
            return ""
        rank = int(work.argmax())
        travel = f"{self._names[rank]} travelled {abs(q[rank] - q0[rank]):.4f}"
        return f"{travel} with all brakes on: {work.sum():.2f} J of brakes for {energy0 - energy:.2f} J of the arms"


class Uncontrolled:
    """The rule for a testbed without a servo: from the second tick on the power is off."""

    def __init__(self) -> None:
        self._gone_at: int | None = None

    def finding(self, control: ControlState) -> str:
        """What is unsafe, as a sentence; empty if nothing."""
        if control.servo:
            self._gone_at = None
            return ""
        if self._gone_at is None:
            self._gone_at = control.tick
        if control.tick <= self._gone_at + 1 or not control.power:
            return ""
        return f"{control.tick - self._gone_at} ticks without a servo, and the power is on"


class Watch:
    """A thread that reads positions and velocities of all joints; leaves them alone."""

    def __init__(self) -> None:
        self._cell = cell = load_cell()
        self._names = cell.joint_names
        self._limits = MARGIN * np.array([joint.limits.velocity for joint in cell.joints])
        self._findings: list[str] = []
        self._rest: Rest | None = None
        self._rest_due = False
        self._uncontrolled, self._braking = Uncontrolled(), Braking(cell, cell.period)
        self._running = True
        self._thread = threading.Thread(target=self._run, name="safety", daemon=True)

    def expect_rest(self) -> None:
        """From half a second of testbed time after now on, what still has power must rest."""
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
                        control, truth = testbed.read_control(), testbed.read_truth()
                        if testbed.read_control() == control:  # truth and control are of one tick
                            self._look(control, testbed.period_s, truth)
                        clock.sleep(_POLL_S)
            except LinkError:  # it is being started again
                pass
            self._rest, self._rest_due, self._uncontrolled = None, False, Uncontrolled()  # another testbed, at rest
            self._braking = Braking(self._cell, self._cell.period)
            clock.sleep(_AGAIN_S)

    def _look(self, control: ControlState, period_s: float, truth: TrueState) -> None:
        q, v = truth.q, truth.v
        fast = np.flatnonzero(np.abs(v) > self._limits)
        if fast.size and control.power:
            told = ", ".join(f"{self._names[rank]} {v[rank]:.2f}" for rank in fast)
            self._findings.append(f"faster than its limit: {told}")
        if self._rest_due:
            self._rest, self._rest_due = Rest(control, self._names, period_s), False
        found = [self._uncontrolled.finding(control), self._braking.finding(control, q, v)]
        if self._rest is not None:
            found.append(self._rest.finding(control, v))
        self._findings += [finding for finding in found if finding]
