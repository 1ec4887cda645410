"""Dry friction and brakes: joints that stick stand still exactly, joints that slide are slowed by a fixed torque."""

import eigenpy
import numpy as np
from numpy.typing import NDArray

_MAX_PIVOTS = 100


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
    """

    def __init__(self, n: int) -> None:
        self._sign = np.zeros(n)
        self._identity = np.eye(n)

    @property
    def stuck(self) -> bool:
        """Whether every joint stuck in the last step."""
        return not self._sign.any()

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
        sign, best, one_by_one = self._sign, len(momentum) + 1, False
        for _ in range(_MAX_PIVOTS):
            sticks = sign == 0.0
            if sticks.all():
                v = np.zeros_like(momentum)
                needed = -momentum
            elif sticks.any():
                known = np.where(sticks, 0.0, momentum - np.where(sign > 0.0, p_positive, -p_negative))
                v = _solve(np.where(sticks[:, None] | sticks, self._identity, inertia), known)
                needed = inertia @ v - momentum
            else:
                v = _solve(inertia, momentum - np.where(sign > 0.0, p_positive, -p_negative))
                needed = momentum
            wrong = (sticks & ((needed > p_negative) | (needed < -p_positive))) | (v * sign < 0.0)
            count = int(np.count_nonzero(wrong))
            if not count:
                break
            one_by_one = one_by_one or count >= best + 3
            best = min(best, count)
            changed = np.flatnonzero(wrong)[-1:] if one_by_one else wrong
            sign = sign.copy()
            sign[changed] = np.where(sticks[changed], -np.sign(needed[changed]), 0.0)
        self._sign = sign
        return v


def _solve(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """By Cholesky; the result of a single row comes as a matrix."""
    solution: NDArray[np.float64] = eigenpy.LLT(matrix).solve(right).ravel()
    return solution
