"""The bank of simulated cameras: true cameras and lights in the mirrored scene."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from im_cell.camera_model import CameraModel
from im_cell.link import Exposure
from im_cell.robot import Cell, Target
from im_cell.robot.truth import CellTruth
from im_cell.sensor import SensorNoise
from im_core.stopwatch import Stopwatch
from im_sim.cameras.laser import LaserLight
from im_sim.cameras.lens import FloatImage, Lens, vignette
from im_sim.cameras.light import Spot, add_spot, image_of_light, reflect
from im_sim.cameras.plates import Plates, TargetPatch, in_world, target_patch
from im_sim.cameras.protocol import CameraSettings
from im_sim.cameras.scene import Drawn, SceneMirror
from im_sim.cameras.sensor import noise_stream, read_out

Array = NDArray[np.float64]

BACKGROUND_DN = 70.0
"""Value of a white surface above the black level, at the nominal exposure."""
STILL_PX = 0.005
"""A rendered scene is used again as long as nothing in it moved more than this."""
STEPS = ("render_s", "warp_s", "plates_s", "lights_s", "laser_s", "noise_s")
"""What :meth:`CameraBank.lap` counts."""
_LEVER_M = 2.0
_NEAREST_M = 0.5


@dataclass
class _Camera:
    name: str
    parent: str
    mounted: CameraModel
    vignette: FloatImage
    renderer_offset: tuple[float, float]
    patches: list[TargetPatch] | None = None
    backdrop: Drawn | None = None
    scene: FloatImage | None = None
    scene_q: Array | None = None
    scene_bodies: Array | None = None

    @cached_property
    def lens(self) -> Lens:
        """Lens of the camera, made for the first image: the making takes as long as a rendering."""
        return Lens(self.mounted, self.renderer_offset)


class CameraBank:
    """Makes the image of each camera for an exposure."""

    def __init__(self, cell: Cell, truth: CellTruth, settings: CameraSettings, scene: SceneMirror, seed: int) -> None:
        """Set up the cameras.

        Args:
            cell: Geometry of the scene.
            truth: What cameras and lights are really like.
            settings: Cameras in use, data sheet and nominal exposure.
            scene: Mirror of the testbed.
            seed: Seed of the noise.
        """
        self._cell = cell
        self._truth = truth
        self._settings = settings
        self._scene = scene
        self._seed = seed
        self._cameras = {name: self._camera(name) for name in settings.cameras}
        self._plates = Plates(cell.targets, scene.pose)
        self._laser = None if truth.laser is None else LaserLight(cell, truth.laser.model(), scene, seed)
        self._prismatic = np.array([joint.kind == "prismatic" for joint in cell.joints])
        self._watch = Stopwatch()
        starts = [body.start for body in cell.objects]
        self._seen = np.concatenate((*starts, np.full(len(cell.devices("gripper")), cell.gripper.initial)))

    def expected(self, camera: str, exposure: Exposure, exposure_s: float, sensor: SensorNoise) -> FloatImage:
        """Expected pixel values of a camera, with black level, shape (h, w) [DN].

        Args:
            camera: Name of the camera.
            exposure: What the shutter saw.
            exposure_s: Length of the exposure [s].
            sensor: How the sensor is set.
        """
        unit = self._cameras[camera]
        self._scene.set_joints(exposure.q_true)
        self._see_bodies(exposure)
        placed = self._placed(unit)
        strength = exposure_s / self._settings.nominal_exposure * self._settings.sensor.gain / sensor.gain
        mean = self._scene_of(unit, placed, exposure.q_true) * np.float32(BACKGROUND_DN)
        with self._watch.step("lights_s"):
            for spot, share in self._spots(camera, placed, exposure):
                add_spot(mean, spot, share)
        with self._watch.step("laser_s"):
            if self._laser is not None:
                self._laser.add(mean, camera, placed, exposure)
        with self._watch.step("lights_s"):
            mean *= unit.vignette * np.float32(strength)
            mean += np.float32(sensor.black_level)
        return mean

    def lap(self) -> dict[str, float]:
        """Where the time went since the last lap, by step [s]."""
        seconds, self._watch = self._watch.seconds, Stopwatch()
        return {step: seconds.get(step, 0.0) for step in STEPS}

    def warm_up(self) -> Iterator[str]:
        """Render one camera after the other at the home position, and yield the name: first images take long."""
        for name, unit in self._cameras.items():
            self._scene.set_joints(self._cell.home)
            self._scene_of(unit, self._placed(unit), self._cell.home)
            yield name

    def read_out(
        self,
        camera: str,
        mean: FloatImage,
        start_tick: int,
        frame: int,
        out: NDArray[np.uint8],
        sensor: SensorNoise,
    ) -> None:
        """Write the noisy 8-bit image of expected values, shape (h, w) [DN], to `out`; see :func:`noise_stream`."""
        with self._watch.step("noise_s"):
            read_out(mean, sensor, noise_stream(self._seed, camera, start_tick, frame), out)

    def spot(self, camera: str, light: str) -> Spot | None:
        """Render a light at the scene's joint positions; None where the camera cannot see the light."""
        placed = self._placed(self._cameras[camera])
        position, axis, diameter = self._light(light)
        spot = self._image(placed, position, axis, diameter)
        return spot if spot is not None and self._clear(position, placed.position, diameter) else None

    def reflections(self, camera: str, light: str) -> list[Spot]:
        """Render the reflections of a light in the cell's metal at the scene's joint positions."""
        placed = self._placed(self._cameras[camera])
        position, axis, diameter = self._light(light)
        spots: list[Spot] = []
        for mirror in self._cell.mirrors:
            pose = self._scene.pose(mirror.link)
            seen = reflect(mirror, *pose, position, axis, placed.position)
            spot = self._image(placed, seen.position, seen.axis, diameter) if seen is not None else None
            if seen is None or spot is None:
                continue
            bounce, camera_at = seen.bounce, placed.position
            free = self._scene.clear(bounce, camera_at) and self._plates.clear(bounce, camera_at)
            if free and self._clear(position, bounce, diameter):
                sigma = float(np.hypot(spot.sigma, mirror.roughness))
                spots.append(Spot(spot.uv, spot.flux * mirror.reflectance, sigma))
        return spots

    def _spots(self, camera: str, placed: CameraModel, exposure: Exposure) -> Iterator[tuple[Spot, float]]:
        """Render all lights in the image of a camera, each with the share of the exposure."""
        for light, fraction in exposure.light_fraction.items():
            if fraction > 0.0:
                direct = self.spot(camera, light)
                for spot in ([direct] if direct is not None else []) + self.reflections(camera, light):
                    yield spot, fraction
        period = self._cell.period
        for lamp in self._cell.lamps:
            share = lamp.lit(exposure.start_tick * period, exposure.end_tick * period) * lamp.brightness
            position = np.array(lamp.position)
            towards = (placed.position - position) / np.linalg.norm(placed.position - position)
            seen = self._image(placed, position, towards, self._cell.led.diameter) if share > 0.0 else None
            if seen is not None and self._clear(position, placed.position, self._cell.led.diameter):
                yield seen, share

    def _light(self, light: str) -> tuple[Array, Array, float]:
        """Return position [m] and axis of a wrist light in the world, and the diameter [m]."""
        led = self._truth.leds[light]
        rotation, origin = self._scene.pose(self._cell.devices("light")[light])
        return origin + rotation @ np.array(led.offset_m), rotation @ np.array(led.axis), led.diameter_m

    def _image(self, placed: CameraModel, position: Array, axis: Array, diameter: float) -> Spot | None:
        return image_of_light(placed, position, axis, diameter, self._cell.led.half_angle, self._cell.optics.blur)

    def _clear(self, light: Array, end: Array, diameter: float) -> bool:
        """Whether nothing stands between the surface of a light and a point of the world."""
        towards = (end - light) / np.linalg.norm(end - light)
        surface = light + 0.5 * diameter * towards
        return self._scene.clear(surface, end) and self._plates.clear(surface, end)

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
        shade = vignette(model, self._cell.optics.vignetting)
        return _Camera(name, true.parent, model, shade, self._scene.renderer_offset)

    def _placed(self, unit: _Camera) -> CameraModel:
        """Return the camera with the pose in the world."""
        if unit.parent == "world":
            return unit.mounted
        rotation, origin = self._scene.pose(unit.parent)
        R_cam_base = unit.mounted.R_cam_base @ rotation.T
        return replace(unit.mounted, R_cam_base=R_cam_base, t_cam_base=unit.mounted.t_cam_base - R_cam_base @ origin)

    def _scene_of(self, unit: _Camera, placed: CameraModel, q: Array) -> FloatImage:
        """Return the brightness of the scene through the lens; rendered anew only after a visible motion."""
        moved = unit.scene_q is None or self._motion_px(unit, q - unit.scene_q) > STILL_PX
        if unit.scene is None or moved or self._bodies_moved(unit):
            with self._watch.step("render_s"):
                if unit.parent != "world" or unit.backdrop is None:
                    unit.backdrop = self._scene.backdrop(unit.lens.pinhole, placed)
                brightness, depth = self._scene.render(unit.lens.pinhole, placed, unit.backdrop)
            with self._watch.step("warp_s"):
                scene = unit.lens.warp(brightness)
            with self._watch.step("plates_s"):
                patches = self._patches(unit, placed)
                if patches:
                    depth = unit.lens.warp_depth(depth)
                for patch in patches:
                    patch.paint(scene, depth, self._cell.optics.blur)
            unit.scene, unit.scene_q, unit.scene_bodies = scene, q.copy(), self._seen
        return unit.scene

    def _patches(self, unit: _Camera, placed: CameraModel) -> list[TargetPatch]:
        """Return the targets in the image of a camera; standing ones of a fixed camera are drawn once."""

        def drawn(targets: Iterable[Target]) -> list[TargetPatch]:
            poses = ((target, in_world(target, self._scene.pose)) for target in targets)
            made = (target_patch(*each, placed, unit.lens.ideal, self._cell.optics.blur) for each in poses)
            return [patch for patch in made if patch is not None]

        if unit.parent != "world" or unit.patches is None:
            unit.patches = drawn(target for target in self._cell.targets if target.parent == "world")
        bodies = zip(self._cell.objects, self._seen[: 7 * len(self._cell.objects)].reshape(-1, 7), strict=True)
        prints = (body.printed(pose) for body, pose in bodies)
        carried = (target for target in self._cell.targets if target.parent != "world")
        return unit.patches + drawn((*carried, *(each for each in prints if each is not None)))

    def _see_bodies(self, exposure: Exposure) -> None:
        """Move free bodies and jaws to where an exposure saw them."""
        if self._cell.objects and exposure.bodies is not None and exposure.jaws is not None:
            bodies = exposure.bodies[: len(self._cell.objects)]
            self._scene.set_bodies(bodies, exposure.jaws)
            self._seen = np.concatenate((bodies.ravel(), exposure.jaws))

    def _bodies_moved(self, unit: _Camera) -> bool:
        """Whether a free body or a jaw was elsewhere when a camera's scene was rendered."""
        if unit.scene_bodies is None:
            return True
        reach = float(np.abs(self._seen - unit.scene_bodies).max(initial=0.0))
        return reach * float(unit.mounted.K[0, 0]) / _NEAREST_M > STILL_PX

    def _motion_px(self, unit: _Camera, dq: Array) -> float:
        """Bound on how far anything moved in the image [px]."""
        reach = float(np.abs(dq) @ np.where(self._prismatic, 1.0, _LEVER_M))
        return reach * float(unit.mounted.K[0, 0]) / _NEAREST_M
