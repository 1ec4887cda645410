"""The bank of simulated cameras: true cameras and lights in the mirrored scene."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_core.camera_model import CameraModel
from im_core.robot import Cell
from im_core.robot.truth import CellTruth
from im_core.testbed_link import Exposure
from im_vss.camera.lens import FloatImage, Lens
from im_vss.camera.light import Spot, add_spot, image_of_light
from im_vss.camera.scene import SceneMirror
from im_vss.camera.sensor import noise_stream, read_out
from im_vss.settings import VssSettings

Array = NDArray[np.float64]

BACKGROUND_DN = 70.0
"""Value of a white surface above the black level, at the nominal exposure."""
STILL_PX = 0.005
"""A rendered scene is used again as long as nothing in it moved more than this."""
_LEVER_M = 2.0
_NEAREST_M = 0.5


@dataclass
class _Camera:
    name: str
    parent: str
    mounted: CameraModel
    lens: Lens
    scene: FloatImage | None = None
    scene_q: Array | None = None


class CameraBank:
    """Makes the image of each camera for an exposure."""

    def __init__(self, cell: Cell, truth: CellTruth, settings: VssSettings, scene: SceneMirror, seed: int) -> None:
        """Set up the cameras.

        Args:
            cell: Geometry of the scene.
            truth: What cameras and lights are really like.
            settings: Data sheet and nominal exposure.
            scene: Mirror of the testbed.
            seed: Seed of the noise.
        """
        self._cell = cell
        self._truth = truth
        self._settings = settings
        self._scene = scene
        self._seed = seed
        self._cameras = {name: self._camera(name) for name in settings.cameras}
        self._prismatic = np.array([joint.kind == "prismatic" for joint in cell.joints])

    def expected(self, camera: str, exposure: Exposure, exposure_s: float) -> FloatImage:
        """Expected pixel values of a camera, with black level, shape (h, w) [DN].

        Args:
            camera: Name of the camera.
            exposure: What the shutter saw.
            exposure_s: Length of the exposure [s].
        """
        unit = self._cameras[camera]
        self._scene.set_joints(exposure.q_true)
        placed = self._placed(unit)
        strength = exposure_s / self._settings.exposure.nominal
        scene = self._scene_of(unit, placed, exposure.q_true)
        mean = scene * np.float32(BACKGROUND_DN * strength) + np.float32(self._settings.sensor.black_level)
        for light, fraction in exposure.light_fraction.items():
            if fraction > 0.0 and (spot := self.spot(camera, light)) is not None:
                add_spot(mean, spot, strength * fraction)
        return mean

    def warm_up(self) -> None:
        """Render each camera once at the home position: a renderer's first images take long."""
        for unit in self._cameras.values():
            self._scene.set_joints(self._cell.home)
            self._scene_of(unit, self._placed(unit), self._cell.home)

    def read_out(self, camera: str, mean: FloatImage, start_tick: int, frame: int, out: NDArray[np.uint8]) -> None:
        """Write the noisy 8-bit image of expected values, shape (h, w) [DN], to `out`; see :func:`noise_stream`."""
        read_out(mean, self._settings.sensor, noise_stream(self._seed, camera, start_tick, frame), out)

    def spot(self, camera: str, light: str) -> Spot | None:
        """Image of a light at the scene's joint positions; None where the camera cannot see it."""
        placed = self._placed(self._cameras[camera])
        led = self._truth.leds[light]
        rotation, origin = self._scene.pose(f"{light.removesuffix('_led')}_wrist")
        position, axis = origin + rotation @ np.array(led.offset_m), rotation @ np.array(led.axis)
        spot = image_of_light(placed, position, axis, led.diameter_m, self._cell.led.half_angle)
        if spot is None:
            return None
        towards = placed.position - position
        surface = position + 0.5 * led.diameter_m * towards / np.linalg.norm(towards)
        return spot if self._scene.clear(surface, placed.position) else None

    def _camera(self, name: str) -> _Camera:
        true = self._truth.cameras[name]
        model = CameraModel(
            true.width,
            true.height,
            np.array(true.K),
            np.array(true.D),
            np.array(true.R_cam_base),
            np.array(true.t_cam_base_m),
        )
        return _Camera(name, true.parent, model, Lens(model, self._scene.renderer_offset))

    def _placed(self, unit: _Camera) -> CameraModel:
        """The camera with its pose in the world."""
        if unit.parent == "world":
            return unit.mounted
        rotation, origin = self._scene.pose(unit.parent)
        R_cam_base = unit.mounted.R_cam_base @ rotation.T
        return replace(unit.mounted, R_cam_base=R_cam_base, t_cam_base=unit.mounted.t_cam_base - R_cam_base @ origin)

    def _scene_of(self, unit: _Camera, placed: CameraModel, q: Array) -> FloatImage:
        """Brightness of the scene through the lens; rendered anew only when something moved visibly."""
        if unit.scene is None or unit.scene_q is None or self._motion_px(unit, q - unit.scene_q) > STILL_PX:
            unit.scene = unit.lens.warp(self._scene.render(unit.lens.pinhole, placed))
            unit.scene_q = q.copy()
        return unit.scene

    def _motion_px(self, unit: _Camera, dq: Array) -> float:
        """Bound on how far anything moved in the image [px]."""
        reach = float(np.abs(dq) @ np.where(self._prismatic, 1.0, _LEVER_M))
        return reach * float(unit.mounted.K[0, 0]) / _NEAREST_M
