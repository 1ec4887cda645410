"""The scene as seen by the cameras: a mirror of the testbed's joint positions, rendered and probed with rays."""

import importlib.util
from typing import NamedTuple

import numpy as np
import pybullet
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.robot import ORIGIN, Cell, Vector, scenery_urdf, urdf
from im_core.errors import ConfigError
from im_sim.bodies import FreeBodies
from im_sim.cameras.lens import FloatImage, Pinhole
from im_sim.urdf_loader import load_urdf

Array = NDArray[np.float64]

_NEAR_M, _FAR_M = 0.03, 9.0
_LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32) / 255.0
_SUN = (0.4, -0.6, 1.0)
_BASE = -1
_MOST_RAYS = 8192


class Drawn(NamedTuple):
    """Picture of a renderer.

    Attributes:
        colours: Red, green, blue, alpha, shape (h, w, 4).
        nearness: Normalised depth, 0 at the near plane and 1 at the far one, shape (h, w).
    """

    colours: NDArray[np.uint8]
    nearness: FloatImage

    def before(self, backdrop: "Drawn") -> "Drawn":
        """Return both as one picture; of two points as near, the present one is seen."""
        seen = self.nearness <= backdrop.nearness
        return Drawn(
            np.where(seen[..., None], self.colours, backdrop.colours), np.minimum(self.nearness, backdrop.nearness)
        )


class SceneMirror:
    """Pybullet client without steps, holding the cell at given joint positions."""

    def __init__(self, cell: Cell, renderer: str) -> None:
        """Load the cell.

        Args:
            cell: Geometry.
            renderer: ``egl``, ``tiny``, or ``auto``: EGL where its plug-in loads.

        Raises:
            ConfigError: EGL is demanded and does not load.
        """
        self._client = pybullet.connect(pybullet.DIRECT)
        self.renderer, self._flag = self._choose(renderer)
        pybullet.setGravity(0.0, 0.0, 0.0, physicsClientId=self._client)
        self._scenery = None if self.renderer == "egl" else pybullet.connect(pybullet.DIRECT)
        if self._scenery is not None:
            load_urdf(scenery_urdf(cell), self._scenery, 0)
        text = urdf(cell, frames=False, grippers=bool(cell.objects), scenery=self._scenery is None)
        self._body = load_urdf(text, self._client, pybullet.URDF_MAINTAIN_LINK_ORDER)
        self._bodies = FreeBodies(cell.objects, self._client)
        self._frames: dict[str, tuple[int, Vector, Vector]] = {"world": (_BASE, ORIGIN, ORIGIN)}
        indices: dict[str, int] = {}
        for index in range(pybullet.getNumJoints(self._body, physicsClientId=self._client)):
            info = pybullet.getJointInfo(self._body, index, physicsClientId=self._client)
            indices[info[1].decode()] = index
            self._frames[info[12].decode()] = (index, ORIGIN, ORIGIN)
        for frame in cell.tree.frames.values():
            self._frames[frame.name] = (self._frames[frame.parent][0], frame.xyz, frame.rpy)
        self._joints = [indices[name] for name in cell.joint_names]
        grippers = [name.removesuffix("_gripper") for name in cell.devices("gripper") if cell.objects]
        self._jaws = [(indices[f"{name}_jaw"], indices[f"{name}_gripper"]) for name in grippers]
        starts = np.array([body.start for body in cell.objects])
        self.set_bodies(starts, np.full(len(grippers), cell.gripper.initial))

    @property
    def renderer_offset(self) -> tuple[float, float]:
        """Measured place of a rendered point at (0, 0), column and row [px]."""
        return (0.0, 0.0) if self.renderer == "egl" else (0.5, -0.5)

    def set_joints(self, q: Array) -> None:
        """Move to joint positions, shape (n,) [rad or m]."""
        pybullet.resetJointStatesMultiDof(
            self._body, self._joints, [[float(value)] for value in q], physicsClientId=self._client
        )

    def set_bodies(self, poses: Array, openings: Array) -> None:
        """Move free bodies to poses, shape (m, 7) [m, -], and jaws to openings, shape (grippers,) [m]."""
        for rank in range(len(self._bodies)):
            self._bodies.place(rank, poses[rank])
        for (first, second), opening in zip(self._jaws, openings.tolist(), strict=True):
            for joint, place in ((first, opening / 2.0), (second, opening)):
                pybullet.resetJointState(self._body, joint, place, physicsClientId=self._client)

    def pose(self, frame: str) -> tuple[Array, Array]:
        """Rotation frame -> world, shape (3, 3), and origin in the world, shape (3,) [m], of a link."""
        index, xyz, rpy = self._frames[frame]
        if index == _BASE:
            return np.eye(3), np.zeros(3)
        state = pybullet.getLinkState(self._body, index, computeForwardKinematics=True, physicsClientId=self._client)
        origin, quaternion = pybullet.multiplyTransforms(
            state[4], state[5], xyz, pybullet.getQuaternionFromEuler(rpy), physicsClientId=self._client
        )
        return np.array(pybullet.getMatrixFromQuaternion(quaternion)).reshape(3, 3), np.array(origin)

    def clear(self, start: Array, end: Array) -> bool:
        """Whether nothing stands between two points of the world, shape (3,) [m]."""
        hit = pybullet.rayTest(list(start), list(end), physicsClientId=self._client)
        return int(hit[0][0]) < 0

    def first_hits(self, starts: Array, ends: Array) -> tuple[Array, Array]:
        """Return the first hits of rays on the robot's surfaces.

        Args:
            starts: Shape (n, 3) [m].
            ends: Shape (n, 3) [m].

        Returns:
            Share of each way that is free, shape (n,), 1 where nothing is met; and outward normals, shape (n, 3).
        """
        share, normals = np.ones(len(starts)), np.zeros((len(starts), 3))
        for first in range(0, len(starts), _MOST_RAYS):
            part = slice(first, first + _MOST_RAYS)
            hits = pybullet.rayTestBatch(starts[part].tolist(), ends[part].tolist(), physicsClientId=self._client)
            for index, (body, _, fraction, _, normal) in enumerate(hits, first):
                if body >= 0:
                    share[index], normals[index] = fraction, normal
        return share, normals

    def backdrop(self, pinhole: Pinhole, camera: CameraModel) -> Drawn | None:
        """Draw the scenery alone, at the pose of `camera`; None with EGL, which draws it with all else.

        Large faces cost TinyRenderer most. A camera that stands still needs them once.
        """
        return None if self._scenery is None else self._drawn(self._scenery, pinhole, camera)

    def render(self, pinhole: Pinhole, camera: CameraModel, backdrop: Drawn | None) -> tuple[FloatImage, FloatImage]:
        """Brightness, 0 to 1, and depth [m] of a pinhole image at the pose of `camera`, each of shape (h, w)."""
        drawn = self._drawn(self._client, pinhole, camera)
        if backdrop is not None:
            drawn = drawn.before(backdrop)
        depth = _FAR_M * _NEAR_M / (_FAR_M - (_FAR_M - _NEAR_M) * drawn.nearness)
        return np.asarray(drawn.colours[..., :3] @ _LUMA, dtype=np.float32), np.asarray(depth, dtype=np.float32)

    def _drawn(self, client: int, pinhole: Pinhole, camera: CameraModel) -> Drawn:
        pixels, buffer = pybullet.getCameraImage(
            pinhole.width,
            pinhole.height,
            viewMatrix=_view(camera),
            projectionMatrix=_projection(pinhole),
            lightDirection=_SUN,
            lightColor=(1.0, 1.0, 1.0),
            lightDistance=10.0,
            lightAmbientCoeff=0.55,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.0,
            shadow=0,
            renderer=self._flag,
            flags=pybullet.ER_NO_SEGMENTATION_MASK,
            physicsClientId=client,
        )[2:4]
        shape = (pinhole.height, pinhole.width)
        colours = np.asarray(pixels, dtype=np.uint8).reshape(*shape, 4)
        return Drawn(colours, np.asarray(buffer, dtype=np.float32).reshape(shape))

    def close(self) -> None:
        """Release the client."""
        pybullet.disconnect(self._client)
        if self._scenery is not None:
            pybullet.disconnect(self._scenery)

    def _choose(self, renderer: str) -> tuple[str, int]:
        if renderer in ("auto", "egl"):
            plugin = importlib.util.find_spec("eglRenderer")
            if plugin is not None and plugin.origin is not None:
                loaded = pybullet.loadPlugin(plugin.origin, "_eglRendererPlugin", physicsClientId=self._client)
                if loaded >= 0:
                    return "egl", pybullet.ER_BULLET_HARDWARE_OPENGL
            if renderer == "egl":
                raise ConfigError("renderer: 'egl' does not load on this host, 'auto' and 'tiny' do", renderer=renderer)
        return "tiny", pybullet.ER_TINY_RENDERER


def _view(camera: CameraModel) -> list[float]:
    """Return the OpenGL view matrix, column by column: OpenGL looks along -z with y up."""
    matrix = np.eye(4)
    flip = np.array([1.0, -1.0, -1.0])
    matrix[:3, :3] = flip[:, None] * camera.R_cam_base
    matrix[:3, 3] = flip * camera.t_cam_base
    return [float(value) for value in matrix.T.ravel()]


def _projection(pinhole: Pinhole) -> list[float]:
    """Return the OpenGL projection matrix, column by column; pixel (0, 0) is centred half a pixel inside the image."""
    width, height, K = pinhole.width, pinhole.height, pinhole.K
    matrix = np.zeros((4, 4))
    matrix[0, 0] = 2.0 * K[0, 0] / width
    matrix[1, 1] = 2.0 * K[1, 1] / height
    matrix[0, 2] = 1.0 - 2.0 * (K[0, 2] + 0.5) / width
    matrix[1, 2] = 2.0 * (K[1, 2] + 0.5) / height - 1.0
    matrix[2, 2] = -(_FAR_M + _NEAR_M) / (_FAR_M - _NEAR_M)
    matrix[2, 3] = -2.0 * _FAR_M * _NEAR_M / (_FAR_M - _NEAR_M)
    matrix[3, 2] = -1.0
    return [float(value) for value in matrix.T.ravel()]
