"""Numbers of sensors, compiled."""

import numpy as np
from numpy.typing import NDArray

def joint_readings(
    states: tuple[tuple[float, ...], ...],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions and velocities, shape (n,) each, of pybullet's joint states.

    Raises:
        TypeError: They are none.
    """

def quantised(
    true: NDArray[np.float64],
    noise: NDArray[np.float64],
    resolution: NDArray[np.float64],
    least: NDArray[np.float64],
    most: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return signals with noise, rounded to the nearest step and cut to the range, shape (n,).

    Raises:
        ValueError: The arguments, shape (n,) each, are not as many.
    """
