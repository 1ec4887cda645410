"""Joint input and output of pybullet, compiled: Bullet's C interface without a Python object for each number."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

class WorldJoints:
    """Joints of one body in a simulation.

    Args:
        client: Pybullet's physics client.
        body: Pybullet's number of the body.
        joints: Pybullet's indices of the joints.

    Raises:
        LinkError: Pybullet has no such interface.
    """

    def __init__(self, client: int, body: int, joints: Sequence[int]) -> None: ...
    def step(self, tau: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities after one step under joint torques, shape (n,) each.

        Raises:
            ValueError: The torques are not as many as the joints.
            LinkError: Pybullet does not carry out the step.
        """

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions and velocities, shape (n,) each [rad or m, by s].

        Raises:
            LinkError: Pybullet does not give the state.
        """

    def touch(self) -> bool:
        """Return whether the body touches anything.

        Raises:
            LinkError: Pybullet does not tell.
        """
