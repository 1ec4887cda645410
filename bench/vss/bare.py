"""The baseline of all frames: pybullet's renderer alone, on the same robot, with none of the project's cameras."""

import importlib.util
import math
import tempfile

import pybullet

from im_cell.robot import Cell, urdf
from im_core.errors import ConfigError

_NEAR_M, _FAR_M = 0.03, 9.0


class Bare:
    """``getCameraImage`` from where a camera stands, of its size."""

    def __init__(self, cell: Cell, camera: str, renderer: str) -> None:
        """Load the robot.

        Args:
            cell: What is rendered.
            camera: Name of the camera.
            renderer: ``egl`` or ``tiny``.

        Raises:
            ConfigError: EGL does not load on this host.
        """
        self._client = pybullet.connect(pybullet.DIRECT)
        self._flag = _load_renderer(renderer, self._client)
        with tempfile.NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
            file.write(urdf(cell, frames=False))
            file.flush()
            pybullet.loadURDF(file.name, useFixedBase=True, physicsClientId=self._client)
        drawn = cell.cameras[camera]
        lens = drawn.intrinsics
        self._size = lens.width, lens.height
        self._view = pybullet.computeViewMatrix(drawn.position, drawn.target, drawn.up)
        angle = math.degrees(2.0 * math.atan(0.5 * lens.height / lens.fy))
        self._projection = pybullet.computeProjectionMatrixFOV(angle, lens.width / lens.height, _NEAR_M, _FAR_M)

    def take_frame(self) -> None:
        """Render an image."""
        pybullet.getCameraImage(
            *self._size, self._view, self._projection, shadow=0, renderer=self._flag,
            flags=pybullet.ER_NO_SEGMENTATION_MASK, physicsClientId=self._client,
        )  # fmt: skip


def _load_renderer(renderer: str, client: int) -> int:
    if renderer == "tiny":
        return int(pybullet.ER_TINY_RENDERER)
    plugin = importlib.util.find_spec("eglRenderer")
    if plugin is None or plugin.origin is None:
        raise ConfigError("renderer 'egl' is not installed on this host", renderer=renderer)
    if pybullet.loadPlugin(plugin.origin, "_eglRendererPlugin", physicsClientId=client) < 0:
        raise ConfigError("renderer 'egl' does not load on this host", renderer=renderer)
    return int(pybullet.ER_BULLET_HARDWARE_OPENGL)
