"""Filters of encoders and errors, compiled."""

import numpy as np
from numpy.typing import NDArray

class VelocityEstimator:
    """Backward difference through a first-order low pass.

    Args:
        n: Number of signals.
        period_s: Servo period [s].
        bandwidth_rad_s: Corner of the low pass [rad/s].
    """

    def __init__(self, n: int, period_s: float, bandwidth_rad_s: float) -> None: ...
    def reset(self) -> None:
        """Forget the past: the next reading is taken as standing still."""

    def update(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Take a reading, shape (n,), and return the derivative, shape (n,).

        That of a signal that is not a number is none either; the first reading after that is taken as standing still.

        Raises:
            ValueError: It has another shape.
        """

    def update_at(self, x: NDArray[np.float64], stamp_ns: int, age_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """As :meth:`update`, of readings that were taken at times of their own.

        A signal without a newer reading keeps its derivative. A newer one is a reading that was taken at least half a
        period after the one before.

        Args:
            x: Readings, shape (n,).
            stamp_ns: Present time, on a clock that is not set back before :meth:`reset` [ns].
            age_s: Ages of the readings, shape (n,) [s]; one that is not a number counts as 0.

        Raises:
            ValueError: An array has another shape.
        """

class ErrorFeedback:
    """Independent PID of each joint; the derivative acts on the error, through a low pass.

    At rest (:meth:`hold`) the integral is frozen and errors that are encoder noise are ignored: the answer does
    not change, friction holds the joint, and it stands exactly still. A disturbance meets the full PID.

    Args:
        kp: Gains, shape (n,).
        kd: Gains of the derivative, shape (n,).
        ki_dt: Gains of the integral in a tick, shape (n,).
        integral_limit: Bound of the integral part, shape (n,), in the unit of the answer.
        smoothing: Share of a new error in the smooth one.
        deadband: Error that is not integrated [rad or m].
        rest_deadband: Change of error that an arm at rest ignores [rad or m].
        rate: Derivative of the error.

    Attributes:
        deadband: Errors that are not integrated, shape (n,) [rad or m].
        smooth_error: Error without most of its noise, shape (n,) [rad or m].
        holding: Whether the arm is at rest.
    """

    deadband: NDArray[np.float64]
    smooth_error: NDArray[np.float64]
    holding: bool
    def __init__(
        self,
        kp: NDArray[np.float64],
        kd: NDArray[np.float64],
        ki_dt: NDArray[np.float64],
        integral_limit: NDArray[np.float64],
        smoothing: float,
        deadband: float,
        rest_deadband: float,
        rate: VelocityEstimator,
    ) -> None: ...
    def reset(self) -> None:
        """No integral, no past."""

    def hold(self, hold: bool) -> None:
        """Freeze or free the integral."""

    def update(self, error: NDArray[np.float64]) -> NDArray[np.float64]:
        """The answer to an error, shape (n,).

        Raises:
            ValueError: It has another shape.
        """

    def integrate(self, tau: NDArray[np.float64], torque_limit: NDArray[np.float64]) -> None:
        """Integrate the last error; no wind-up: a joint with saturated torque integrates only back.

        Args:
            tau: Torques that followed from the answer, shape (n,) [Nm or N].
            torque_limit: Largest torques, shape (n,) [Nm or N].

        Raises:
            ValueError: One has another shape.
        """

def friction_torque(
    v: NDArray[np.float64],
    turns: NDArray[np.float64],
    share: float,
    stiction: float,
    positive: NDArray[np.float64],
    negative: NDArray[np.float64],
    viscous: NDArray[np.float64],
    pushed: ErrorFeedback | None = None,
    creeping: bool = False,
) -> NDArray[np.float64]:
    """Return Coulomb and viscous friction, shape (n,) [Nm or N]; all arguments that are arrays have that shape.

    A joint whose wanted velocity is 0 is given the share of dry friction at which a joint stuck beside the setpoint
    almost breaks loose; the integral does the rest. At rest there is no push: friction alone holds the joint.

    Args:
        v: Wanted velocities [rad/s or m/s].
        turns: Directions, -1 to 1, without a leap at 0.
        share: Share of dry friction of moving joints.
        stiction: Share of dry friction of joints that are to leave their place.
        positive: Dry friction of joints that move forwards [Nm or N].
        negative: Dry friction of joints that move backwards [Nm or N].
        viscous: Viscous friction [Nm s/rad or N s/m].
        pushed: Whose error joints are helped to leave; None: they are not helped.
        creeping: Whether joints that move are helped as well, the slower the more: else, of a joint too slow for its
            friction to be fed forward, the integral makes up for that, and has too much when the joint moves on.

    Raises:
        ValueError: An array has another shape.
    """

def model_torque(
    gravity_share: float,
    gravity: NDArray[np.float64],
    friction: NDArray[np.float64],
    inertia_share: float,
    inertia: NDArray[np.float64] | None,
    a: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return gravity, friction and inertia torques together, shape (n,) [Nm or N], as the arrays given.

    Args:
        gravity_share: Share of gravity.
        gravity: Torques that hold the joints against gravity [Nm or N].
        friction: Torques of friction [Nm or N].
        inertia_share: Share of inertia.
        inertia: Inertia of each joint [kg m2 or kg]; None: no torque for the acceleration.
        a: Wanted accelerations [rad/s2 or m/s2].

    Raises:
        ValueError: An array has another shape.
    """
