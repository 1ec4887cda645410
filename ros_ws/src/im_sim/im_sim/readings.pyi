"""Numbers of sensors, compiled."""

import numpy as np
from numpy.typing import NDArray

class Readings:
    """Readings of encoders, wrist force-torque sensors and jaws, quantised and cut to the range.

    A joint is off its encoder by the error of its gear: the sum of its
    :func:`~im_cell.robot.arm_errors.gear_waves`, each times its coefficient.

    Args:
        gear: Coefficients of each joint, shape (n, 4) [rad].
        resolution: Step of each signal, of encoders, wrists and jaws, shape (m,).
        most: End of the range of each signal, shape (m,).
        wrists: Number of the wrist sensors, of six signals each.

    Raises:
        ValueError: The arguments are not as many as the signals.
    """

    def __init__(
        self, gear: NDArray[np.float64], resolution: NDArray[np.float64], most: NDArray[np.float64], wrists: int
    ) -> None: ...
    def told(
        self,
        q: NDArray[np.float64],
        wrench: NDArray[np.float64],
        force: NDArray[np.float64],
        noise: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return the readings of a true state, shapes as those given.

        Args:
            q: Positions, shape (n,) [rad or m].
            wrench: Of each wrist, shape (wrists, 6) [N, Nm].
            force: Between the jaws of each gripper, shape (grippers,) [N].
            noise: Of each signal, bias included, shape (m,).

        Raises:
            TypeError: An argument is no array of floats.
            ValueError: An array has another size.
        """
