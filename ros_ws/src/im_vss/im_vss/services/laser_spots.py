"""What Services that look at the laser's spot with two cameras have in common."""

import numpy as np
from numpy.typing import NDArray

from im_cell.frames import FrameSet
from im_cell.link import LaserBeam
from im_core.errors import ConfigError, DataError, StateError
from im_vss.managers import VisionClient
from im_vss.rig import Rig
from im_vss.services.service import VisionService
from im_vss.services.svc_spot_find import CameraSpot
from im_vss.tools.tool_triangulate import StereoFinding

Array = NDArray[np.float64]


def fixed_cameras(rig: Rig, names: tuple[str, ...], count: int | None) -> tuple[str, ...]:
    """The cameras of a request, if they are fixed to the world, calibrated, and as many as needed.

    Raises:
        ImError: They are not.
    """
    cameras = rig.settings.check_cameras(names)
    if count is not None and len(cameras) != count:
        raise ConfigError(f"{count} cameras are needed, got {len(cameras)}: {', '.join(cameras)}")
    for camera in cameras:
        if rig.book[camera].parent != "world":
            raise DataError(f"{camera} moves with {rig.book[camera].parent}: fixed cameras are needed")
    nominal = [camera for camera in cameras if not rig.book[camera].calibrated]
    if nominal:
        raise StateError(f"not calibrated: {', '.join(nominal)}; no point in the world from these", cameras=nominal)
    return cameras


def look(
    service: VisionService, client: VisionClient, cameras: tuple[str, ...], beam: LaserBeam | None, exposure_s: float
) -> tuple[tuple[CameraSpot, ...], StereoFinding, LaserBeam, FrameSet]:
    """A pair of frames, the spot in each camera, and the point.

    Args:
        service: Whose Tools are called.
        client: Who asks.
        cameras: Two.
        beam: What to show; None: as the scanner is.
        exposure_s: Length of an exposure [s]; 0: the one that is set.

    Returns:
        What each camera saw, what follows from it, what the scanner's sensors said, and the frames.

    Raises:
        ImError: The hardware does not deliver, or a mirror would turn too far.
    """
    images: FrameSet
    images, reading = service.tool("tool_laser_snap")(client, cameras, beam, exposure_s)
    findings = [service.tool("tool_laser_spot")(*images.frames[camera]) for camera in cameras]
    stereo: StereoFinding = service.tool("tool_triangulate")((cameras[0], cameras[1]), tuple(findings))
    spots = tuple(
        CameraSpot(camera, images.frames[camera][1].stamp_ns, finding)
        for camera, finding in zip(cameras, findings, strict=True)
    )
    return spots, stereo, reading, images


def why_not(rig: Rig, spots: tuple[CameraSpot, ...], stereo: StereoFinding, beam: LaserBeam) -> str:
    """Why there is no point, one clause for each camera that lacks the spot; empty if there is a point.

    One camera's spot and the beam say where the other would see it.
    """
    if stereo.point is not None:
        return ""
    if beam.power <= 0.0:
        return "the laser is not lit"
    missing = [spot for spot in spots if not spot.finding.candidates]
    if len(missing) == len(spots):
        names = " and ".join(spot.camera for spot in spots)
        return f"seen by neither {names}: the beam ends out of their sight, hidden from them, or on something too dark"
    if not missing:
        return stereo.cause
    (lacking,), (seeing,) = missing, [spot for spot in spots if spot.finding.candidates]
    try:
        place = _beam_meets(rig, seeing, beam)
    except DataError as error:
        return f"{lacking.camera}: {lacking.finding.cause}; {seeing.camera}: {error.message}"
    model = rig.book[lacking.camera].model
    uv = model.project(place)
    if np.isnan(uv).any():
        return f"out of sight of {lacking.camera}: it would be behind it"
    where = f"it would be at ({uv[0]:.0f}, {uv[1]:.0f}) px"
    if not bool(model.contains(uv)):
        return f"out of sight of {lacking.camera}: {where}"
    return f"{lacking.camera}: hidden, or too dark: {where}; {lacking.finding.cause}"


def _beam_meets(rig: Rig, seeing: CameraSpot, beam: LaserBeam) -> Array:
    """Where on the beam the spot that one camera sees is, shape (3,) [m].

    Raises:
        DataError: The camera's lens model cannot be inverted there.
    """
    model, spot = rig.book[seeing.camera].model, seeing.finding.candidates[0]
    starts, ways = rig.scanner.book.entry.model.rays([beam.mirror1, beam.mirror2])
    ray = model.ray([spot.u, spot.v])
    cosine = float(ray @ ways)
    between = starts - model.position
    distance = (float(between @ ray) * cosine - float(between @ ways)) / max(1.0 - cosine**2, 1e-12)
    return np.asarray(starts + distance * ways)
