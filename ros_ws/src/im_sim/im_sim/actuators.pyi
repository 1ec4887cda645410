"""Motors, gears and friction, compiled: from commanded torques to the torques pybullet must apply."""

import numpy as np
from numpy.typing import NDArray

from im_cell.robot import Cell
from im_sim.dynamics import Dynamics

class DryFriction:
    """Velocities after a time step under dry friction: sticking joints stand still exactly.

    With the inertia matrix H, the momentum b that all other torques would give and the friction impulse p,

        H v = b + p,   -p_positive <= p <= p_negative,
        v > 0: p = -p_positive,   v < 0: p = p_negative,   v = 0: p in between,

    a box-constrained linear complementarity problem with one solution, found by block principal pivoting: J.J. Judice,
    F.M. Pires, "A block principal pivoting algorithm for large-scale strictly monotone linear complementarity
    problems", Computers & Operations Research 21 (1994). The pivots of the last step are where the next one begins.

    Args:
        n: Number of joints.

    Attributes:
        stuck: Whether every joint stuck in the last step.
        all_slip: Whether every joint slid in the last step.
        impulse: Of friction on joints that go on sliding as in the last step, shape (n,) [Nms or Ns].
    """

    stuck: bool
    all_slip: bool
    impulse: NDArray[np.float64]
    def __init__(self, n: int) -> None: ...
    def bound(self, p_positive: NDArray[np.float64], p_negative: NDArray[np.float64]) -> None:
        """Set the largest friction impulses.

        Args:
            p_positive: On joints that move forwards, shape (n,), >= 0 [Nms or Ns].
            p_negative: On joints that move backwards.
        """

    def slips_on(self, v: NDArray[np.float64]) -> bool:
        """Return whether sliding joints with velocities ``v``, shape (n,), have not come to a stop."""

    def factorise(self, inertia: NDArray[np.float64]) -> None:
        """Compute the part of :meth:`solve` depending on H only, for joints in the state of the last step."""

    def solve(self, inertia: NDArray[np.float64], momentum: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocities v at the end of the step.

        Args:
            inertia: H, shape (n, n), positive definite [kg m2 or kg].
            momentum: b, shape (n,) [Nms or Ns].

        Returns:
            v, shape (n,) [rad/s or m/s]; exactly 0 where a joint sticks.
        """

class Actuators:
    """Actuators between torque commands and joints: rotors, gears, friction, brakes.

    pybullet knows neither rotor inertia nor dry friction. With the mass matrix M(q), bias torques h(q, v), reflected
    rotor inertias A and viscous frictions B (both diagonal), the joints accelerate over a step dt by a = (v' - v) / dt:

        (M + C) a = tau - B v + p / dt - h,   C = A + dt B

    with the impulse p of dry friction and brakes (:class:`DryFriction`). pybullet, which integrates
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

    def __init__(self, cell: Cell, dynamics: Dynamics, dt: float) -> None: ...
    def command(self, tau: NDArray[np.float64], power: bool, brakes: NDArray[np.bool_]) -> None:
        """Set the torques [Nm or N], shape (n,), and which brakes hold, shape (n,).

        Beyond the motors' limits torques are cut, NaN gives none. Without power there is no torque.
        """

    @property
    def brakes(self) -> NDArray[np.bool_]:
        """Which brakes are engaged, shape (n,)."""

    @property
    def stuck(self) -> bool:
        """Whether dry friction or the brake held every joint in the last step."""

    def touch(self, torques: NDArray[np.float64] | None) -> None:
        """Set the joint torques of contacts to count on in the next step, shape (n,) [Nm or N]; None: no contact."""

    def prepare(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> None:
        """Compute ahead of the command the part of :meth:`applied` depending on ``q`` and ``v`` only."""

    def applied(self, q: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return torques for a simulator without rotors, friction and loads, for one step, shape (n,) [Nm or N].

        Args:
            q: True positions, shape (n,) [rad or m].
            v: True velocities, shape (n,) [rad/s or m/s].
        """
