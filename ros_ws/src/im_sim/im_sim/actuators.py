"""Motors, gears and brakes: from commanded torques to the torques pybullet must apply."""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_sim.dynamics import Dynamics
from im_sim.friction import DryFriction


class HoldingBrakes:
    """Brakes with a stated delay to hold, or let go, after the command: springs and coils take the time.

    Args:
        n: Number of joints.
        delay_ticks: Ticks from a command until a brake obeys.

    Attributes:
        engaged: Which brakes hold, shape (n,); another array after every change.
    """

    def __init__(self, n: int, delay_ticks: int) -> None:
        self.engaged = np.ones(n, dtype=np.bool_)
        self._delay_ticks = delay_ticks
        self._waited = np.zeros(n, dtype=np.intp)
        self._agreed = self.engaged.tobytes()

    @property
    def obey(self) -> bool:
        """Whether every brake is in the commanded state."""
        return self._agreed != b""

    def tick(self, commanded: NDArray[np.bool_]) -> None:
        """Let a tick pass under a command, shape (n,); a command taken back starts the delay anew."""
        if commanded.tobytes() == self._agreed:
            return
        self._waited = np.where(commanded != self.engaged, self._waited + 1, 0)
        self.engaged = np.where(self._waited > self._delay_ticks, commanded, self.engaged)
        differ = commanded != self.engaged
        self._waited *= differ
        self._agreed = b"" if differ.any() else commanded.tobytes()


class Actuators:
    """Actuators between torque commands and joints: rotors, gears, friction, brakes.

    pybullet knows neither rotor inertia nor dry friction. With the mass matrix M(q), bias torques h(q, v), reflected
    rotor inertias A and viscous frictions B (both diagonal), the joints accelerate over a step dt by a = (v' - v) / dt:

        (M + C) a = tau - B v + p / dt - h,   C = A + dt B

    with the impulse p of dry friction and brakes (:class:`~im_sim.friction.DryFriction`). pybullet, which integrates
    M a = tau_applied - h, arrives at the same v' under

        tau_applied = M a + h = tau - B v + p / dt - C a.

    Exact in free motion; where something is touched, the contact feels the arm without its rotors and loads, unless its
    torque of the step before is given (:meth:`touch`): it is then on both sides, as -h is. While
    something is held, M and h on the first line are those with it, and pybullet's own on the last.

    As long as every joint goes on sliding, p is known beforehand and the articulated-body algorithm gives a; else M is
    needed to find out which joints stick.

    Args:
        cell: Motor, gear and limit of each joint.
        dynamics: Of the arms with their loads.
        dt: Length of a step [s].
    """

    def __init__(self, cell: Cell, dynamics: Dynamics, dt: float) -> None:
        self._dynamics = dynamics
        self._viscous = cell.per_joint("viscous")
        self._own_inertia = cell.per_joint("rotor_inertia") + dt * self._viscous
        dynamics.reflect(self._own_inertia)
        self._dt = np.full_like(self._viscous, dt)  # numpy is quicker with two arrays than with a number and an array
        self._positive = cell.per_joint("coulomb_positive")
        self._negative = cell.per_joint("coulomb_negative")
        self._held: bytes | None = None
        self._torque_limits = cell.per_joint("limits.torque")
        self._least_torques = -self._torque_limits
        self._brake_torques = cell.per_joint("brake")
        n = len(self._viscous)
        self._friction = DryFriction(n)
        self._found: NDArray[np.float64] | None = None
        self._touch: NDArray[np.float64] | None = None
        self.command(np.zeros(n), False, np.ones(n, dtype=np.bool_))

    def command(self, tau: NDArray[np.float64], power: bool, brakes: NDArray[np.bool_]) -> None:
        """Set the torques [Nm or N], shape (n,), and which brakes hold, shape (n,).

        Beyond the motors' limits torques are cut, NaN gives none. Without power there is no torque.
        """
        if power:
            if not math.isfinite(tau.dot(tau)):
                tau = np.where(np.isfinite(tau), tau, 0.0)
            self._tau = np.minimum(np.maximum(tau, self._least_torques), self._torque_limits)
        else:
            self._tau = np.zeros(len(tau))
        self._sliding: NDArray[np.float64] | None = None  # the impulses that the torques of sliding joints contain
        self._brakes = brakes
        held_now = self._brakes.tobytes()
        if held_now != self._held:
            self._held = held_now
            held = np.where(self._brakes, self._brake_torques, 0.0)
            self._friction.bound(self._dt * (self._positive + held), self._dt * (self._negative + held))

    @property
    def brakes(self) -> NDArray[np.bool_]:
        """Which brakes are engaged, shape (n,)."""
        return self._brakes

    @property
    def stuck(self) -> bool:
        """Whether dry friction or the brake held every joint in the last step."""
        return self._friction.stuck

    def touch(self, torques: NDArray[np.float64] | None) -> None:
        """Set the joint torques of contacts to count on in the next step, shape (n,) [Nm or N]; None: no contact."""
        self._touch = torques

    def prepare(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Compute ahead of the command the part of :meth:`applied` depending on ``q`` and ``v`` only."""
        if self._friction.all_slip:
            return  # most likely M is not needed
        self._find_inertia(q, v)
        self._friction.factorise(self._inertia)

    def applied(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return torques for a simulator without rotors, friction and loads, for one step, shape (n,) [Nm or N].

        Args:
            q: True positions, shape (n,) [rad or m].
            v: True velocities, shape (n,) [rad/s or m/s].
        """
        dynamics, friction = self._dynamics, self._friction
        viscous: NDArray[np.float64] = self._viscous * v
        sliding = friction.all_slip
        if sliding:
            if self._sliding is not friction.impulse:
                self._sliding, self._tau_sliding = friction.impulse, self._tau + friction.impulse / self._dt
            given = self._tau_sliding - viscous
            felt = given if self._touch is None else given + self._touch
            a = pin.aba(dynamics.model, dynamics.data, q, v, felt, pin.Convention.WORLD)
            sliding = friction.slips_on(v + self._dt * a)
        if sliding:
            torques: NDArray[np.float64] = given - self._own_inertia * a
        else:
            if self._found is not v or self._found_for is not dynamics.model:
                self._find_inertia(q, v)
            inertia, bias = self._inertia, self._bias
            impulse = self._tau - viscous
            impulse -= bias
            if self._touch is not None:
                impulse += self._touch
            impulse *= self._dt
            a = friction.solve(inertia, self._momentum + impulse)
            a -= v
            a /= self._dt
            torques = inertia.dot(a)
            torques += bias
            torques -= self._own_inertia * a
            if self._touch is not None:
                torques -= self._touch
        if dynamics.loaded:  # pybullet moves the arms without what the grippers hold
            torques = pin.rnea(dynamics.bare, dynamics.bare_data, q, v, a) - self._own_inertia * a
            if self._touch is not None:
                torques -= self._touch
        return torques

    def _find_inertia(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Find M, h and M v."""
        dynamics = self._dynamics
        self._inertia: NDArray[np.float64] = pin.crba(dynamics.model, dynamics.data, q)
        self._bias: NDArray[np.float64] = pin.nonLinearEffects(dynamics.model, dynamics.data, q, v)
        self._momentum: NDArray[np.float64] = self._inertia.dot(v)
        self._found, self._found_for = v, dynamics.model
