"""Motors, gears and brakes: from commanded torques to the torques pybullet must apply."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_core.robot import Cell
from im_sim.dynamics import Dynamics
from im_sim.friction import DryFriction

BRAKE_FACTOR = 5.0  # a brake holds that many times the motor's largest torque


class Actuators:
    """What sits between a torque command and a joint.

    pybullet knows neither rotor inertia nor dry friction. With the mass matrix M(q), bias torques h(q, v), reflected
    rotor inertias A and viscous frictions B (both diagonal), the joints move over a step dt by

        (M + A + dt B) v' = (M + A) v + dt (tau - h) + p

    with the impulse p of dry friction and brakes (:class:`~im_sim.friction.DryFriction`). pybullet, which integrates
    M (v' - v) / dt = tau_applied - h, arrives at the same v' under

        tau_applied = M (v' - v) / dt + h.

    Exact in free motion; where something is touched, the contact feels the arm without its rotors and loads. While
    something is held, M and h on the first line are those with it, and pybullet's own on the last.

    Args:
        cell: Motor, gear and limit of each joint.
        dynamics: Of the arms with their loads.
        dt: Length of a step [s].
    """

    def __init__(self, cell: Cell, dynamics: Dynamics, dt: float) -> None:
        self._dt = dt
        self._dynamics = dynamics
        self._rotors = cell.per_joint("rotor_inertia")
        self._added_inertia = np.diag(self._rotors + dt * cell.per_joint("viscous"))
        self._positive = cell.per_joint("coulomb_positive")
        self._negative = cell.per_joint("coulomb_negative")
        self._held: bytes | None = None
        self._torque_limits = cell.per_joint("limits.torque")
        self._brake_torques = BRAKE_FACTOR * self._torque_limits
        self._friction = DryFriction(len(self._rotors))
        self.command(np.zeros(len(self._rotors)), False, np.ones(len(self._rotors), dtype=np.bool_))

    def command(self, tau: NDArray[np.float64], power: bool, brakes: NDArray[np.bool_]) -> None:
        """Set the torques [Nm or N], shape (n,); beyond the motors' limits they are cut, NaN gives none.

        Without power there is no torque and every brake is engaged.
        """
        limits = self._torque_limits
        if power:
            finite = np.where(np.isfinite(tau), tau, 0.0)
            self._tau = np.minimum(np.maximum(finite, -limits), limits)
        else:
            self._tau = np.zeros_like(limits)
        self._brakes = brakes | (not power)
        if self._brakes.tobytes() != self._held:
            self._held = self._brakes.tobytes()
            held = np.where(self._brakes, self._brake_torques, 0.0)
            self._friction.bound(self._dt * (self._positive + held), self._dt * (self._negative + held))

    @property
    def brakes(self) -> NDArray[np.bool_]:
        """Which brakes are engaged, shape (n,)."""
        return self._brakes

    @property
    def stuck(self) -> bool:
        """Whether, in the last step, every joint was held by dry friction or its brake."""
        return self._friction.stuck

    def applied(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Torques for a simulator without rotors, friction and loads, for one step, shape (n,) [Nm or N].

        Args:
            q: True positions, shape (n,) [rad or m].
            v: True velocities, shape (n,) [rad/s or m/s].
        """
        dt, dynamics = self._dt, self._dynamics
        mass = pin.crba(dynamics.model, dynamics.data, q)
        bias = pin.nonLinearEffects(dynamics.model, dynamics.data, q, v)
        momentum = mass.dot(v) + self._rotors * v + dt * (self._tau - bias)
        after = self._friction.solve(mass + self._added_inertia, momentum)
        if dynamics.loaded:  # pybullet moves the arms without what the grippers hold
            mass = pin.crba(dynamics.bare, dynamics.bare_data, q)
            bias = pin.nonLinearEffects(dynamics.bare, dynamics.bare_data, q, v)
        torques: NDArray[np.float64] = mass.dot(after - v) / dt + bias
        return torques
