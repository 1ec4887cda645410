"""Dry friction and brakes: joints that stick stand still exactly, joints that slide are slowed by a fixed torque."""

import eigenpy
import numpy as np
from numpy.typing import NDArray

_MAX_PIVOTS = 1000
# After so many block pivots that make nothing better, one joint is turned at a time until something is: block pivots
# can go round in circles, single ones (K.G. Murty, 1974) cannot.
_BLOCKS_IN_VAIN = 4


class DryFriction:
    """Velocities after a time step under dry friction.

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
    """

    def __init__(self, n: int) -> None:
        self._identity = np.eye(n)
        self._pivot(np.zeros(n))

    def solve(
        self,
        inertia: NDArray[np.float64],
        momentum: NDArray[np.float64],
        p_positive: NDArray[np.float64],
        p_negative: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Velocities v at the end of the step.

        Args:
            inertia: H, shape (n, n), positive definite [kg m2 or kg].
            momentum: b, shape (n,) [Nms or Ns].
            p_positive: Largest friction impulse on joints that move forwards, shape (n,), >= 0 [Nms or Ns].
            p_negative: The same backwards.

        Returns:
            v, shape (n,) [rad/s or m/s]; exactly 0 where a joint sticks.
        """
        best, in_vain = len(momentum) + 1, 0
        for _ in range(_MAX_PIVOTS):
            sign, sticks = self._sign, self._sticks
            if self.stuck:
                v = np.zeros_like(momentum)
                needed = -momentum
            else:
                slipping = momentum - np.where(sign > 0.0, p_positive, -p_negative)
                v = _solve(np.where(self._fixed, self._identity, inertia), np.where(sticks, 0.0, slipping))
                needed = inertia @ v - momentum
            wrong = (v * sign < 0.0) | (sticks & ((needed > p_negative) | (needed < -p_positive)))
            if not wrong.any():
                return v
            count = int(np.count_nonzero(wrong))
            in_vain = 0 if count < best else in_vain + 1
            best = min(best, count)
            changed = wrong if in_vain < _BLOCKS_IN_VAIN else np.flatnonzero(wrong)[-1:]
            sign = sign.copy()
            sign[changed] = np.where(sticks[changed], -np.sign(needed[changed]), 0.0)
            self._pivot(sign)
        return v

    def _pivot(self, sign: NDArray[np.float64]) -> None:
        """Assume which joints move forwards (1), backwards (-1) or stick (0)."""
        self._sign = sign
        self._sticks = sign == 0.0
        self._fixed = self._sticks[:, None] | self._sticks
        self.stuck = bool(self._sticks.all())


def _solve(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """By Cholesky; the result of a single row comes as a matrix."""
    solution: NDArray[np.float64] = eigenpy.LLT(matrix).solve(right).ravel()
    return solution
