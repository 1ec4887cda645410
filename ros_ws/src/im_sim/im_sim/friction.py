"""Dry friction and brakes: sticking joints stand still exactly, sliding joints are slowed by a fixed torque."""

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
        all_slip: Whether every joint slid in the last step.
        impulse: Of friction on joints that go on sliding as in the last step, shape (n,) [Nms or Ns].
    """

    def __init__(self, n: int) -> None:
        self._identity = np.eye(n)
        self._cholesky = eigenpy.LLT(n)
        self._sign = self._zero = np.zeros(n)
        self.bound(np.zeros(n), np.zeros(n))

    def bound(self, p_positive: NDArray[np.float64], p_negative: NDArray[np.float64]) -> None:
        """Set the largest friction impulses.

        Args:
            p_positive: On joints that move forwards, shape (n,), >= 0 [Nms or Ns].
            p_negative: On joints that move backwards.
        """
        self._least, self._most = -p_positive, p_negative
        self._pivot(self._sign)

    def slips_on(self, v: NDArray[np.float64]) -> bool:
        """Return whether sliding joints with velocities ``v``, shape (n,), have not come to a stop."""
        return 1 not in (v * self._sign < self._zero).tobytes()

    def factorise(self, inertia: NDArray[np.float64]) -> None:
        """Compute the part of :meth:`solve` depending on H only, for joints in the state of the last step."""
        if not self.stuck:
            self._cholesky.compute(inertia * self._coupled + self._alone)
        self._factorised: NDArray[np.float64] | None = inertia

    def solve(self, inertia: NDArray[np.float64], momentum: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the velocities v at the end of the step.

        Args:
            inertia: H, shape (n, n), positive definite [kg m2 or kg].
            momentum: b, shape (n,) [Nms or Ns].

        Returns:
            v, shape (n,) [rad/s or m/s]; exactly 0 where a joint sticks.
        """
        best, in_vain = len(momentum) + 1, 0
        for _ in range(_MAX_PIVOTS):
            v, free = self._assumed(inertia, momentum)
            wrong = (free > self._upper) | (free < self._lower)
            count = wrong.tobytes().count(1)  # a tenth of what numpy takes to count
            if count == 0:
                return v
            in_vain = 0 if count < best else in_vain + 1
            best = min(best, count)
            changed = wrong if in_vain < _BLOCKS_IN_VAIN else np.flatnonzero(wrong)[-1:]
            sign = self._sign.copy()
            sign[changed] = np.where(self._sticks[changed], -np.sign(free[changed]), 0.0)
            self._pivot(sign)
        return v

    def _assumed(
        self, inertia: NDArray[np.float64], momentum: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return velocities of the assumed state, and the free values: v of slipping joints, p of sticking joints."""
        if self.stuck:
            return np.zeros_like(momentum), -momentum
        if self._factorised is not inertia:
            self.factorise(inertia)
        # The solution of a single row comes as a matrix.
        v: NDArray[np.float64] = self._cholesky.solve((momentum + self.impulse) * self._slips).ravel()
        return v, v + (inertia.dot(v) - momentum) * self._holds

    def _pivot(self, sign: NDArray[np.float64]) -> None:
        """Assume which joints move forwards (1), backwards (-1) or stick (0)."""
        self._sign = sign
        self._sticks = sign == 0.0
        self._slips = np.abs(sign)
        self._holds = 1.0 - self._slips
        self.impulse = np.where(sign > 0.0, self._least, self._most)
        self._lower = np.where(self._sticks, self._least, np.where(sign > 0.0, 0.0, -np.inf))
        self._upper = np.where(self._sticks, self._most, np.where(sign < 0.0, 0.0, np.inf))
        self._coupled = self._slips[:, None] * self._slips  # rows and columns of joints that stick become those of
        self._alone = np.where(self._coupled > 0.0, 0.0, self._identity)  # the identity
        self._factorised = None
        count = self._sticks.tobytes().count(1)
        self.stuck: bool = count == len(sign)
        self.all_slip: bool = count == 0
