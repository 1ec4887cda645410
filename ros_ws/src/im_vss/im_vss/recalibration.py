"""Calibrations again, out of a bag: recorded observations, or spots found anew in recorded images."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from im_bag.reading import messages_of, topics_of
from im_core.errors import DataError, StateError
from im_core.jsontext import JsonError, decode_json
from im_vss.camera_poses import Pose, at_rest
from im_vss.services.calibrate import CalibrateRequest, Mount, Observation, SeenSpot
from im_vss.settings import VssSettings
from im_vss.spot import SearchDisc, find_spot

CALLS, CALL = "/vss/calibrate/_service_event", "im_msgs/srv/Calibrate_Event"
LOOKS, LOOK = "/vss/spot_find/_service_event", "im_msgs/srv/SpotFind_Event"
IMAGE, CAMERA_INFO, TRANSFORMS = "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
#: What is read of the messages of this workspace.
FIELDS = {
    "im_msgs/srv/Calibrate_Request": ("cameras", "observations", "known_lengths", "directory", "apply"),
    "im_msgs/srv/Calibrate_Response": ("success", "status", "report"),
    "im_msgs/srv/SpotFind_Response": ("candidates",),
    "im_msgs/msg/CalibrationReport": ("json",),
    "im_msgs/msg/KnownLength": ("length", "sd", "first", "second"),
    "im_msgs/msg/Observation": ("pose", "wrist", "position_covariance", "spots"),
    "im_msgs/msg/Spot": ("camera", "stamp", "found", "u", "v", "covariance"),
    "im_msgs/msg/SpotCandidates": ("camera", "stamp", "predicted", "u", "v", "radius"),
    "im_msgs/msg/Status": ("message",),
}
_REQUEST_RECEIVED, _RESPONSE_SENT = 1, 2
_PAIR_NS = 500_000_000
"""The exposure without light comes right before the one with it; an older image is of another look."""


@dataclass
class RecordedCalibration:
    """Call of the Service ``calibrate``, as held by a bag.

    Attributes:
        request: The message `im_msgs/srv/Calibrate` of the request.
        logged_ns: When it came [ns].
        report: What was answered, as in ``report.json``; None: there was no estimate, or the answer is not in the bag.
        refusal: Why there was no estimate; empty: there was one, or the answer is not in the bag.
    """

    request: Any
    logged_ns: int
    report: Mapping[str, Any] | None = None
    refusal: str = ""

    def image_sizes(self) -> dict[str, tuple[int, int]]:
        """Return width and height of the images of cameras [px], for cameras named in the answer."""
        sizes = {}
        cameras = (self.report or {}).get("cameras")
        for camera in cameras if isinstance(cameras, list) else ():
            match camera:
                case {"name": str(name), "width": int(width), "height": int(height)} if min(width, height) > 0:
                    sizes[name] = width, height
        return sizes

    def led_offset(self) -> tuple[tuple[float, float, float], float] | None:
        """Return the light's nominal place in the wrist frame and the prior deviation [m]; None: not in the answer."""
        match self.report:
            case {
                "led_offset_nominal_m": [float() | int() as x, float() | int() as y, float() | int() as z],
                "led_offset_prior_sd_m": float() | int() as deviation,
            }:
                return (x, y, z), deviation
        return None


def recorded_calibrations(bag: Path) -> list[RecordedCalibration]:
    """Return the calibrations of a bag, in the order of the requests.

    Raises:
        DataError: It cannot be read, or holds none.
    """
    if CALLS not in topics_of(bag):
        raise DataError(f"{bag}: it holds no calibration, there is no topic {CALLS} in it", topic=CALLS)
    asked: dict[tuple[bytes, int], RecordedCalibration] = {}
    for message in messages_of(bag, {CALLS: (CALL,)}, FIELDS):
        info = message.content.info
        key = bytes(bytearray(info.client_gid)), int(info.sequence_number)
        if info.event_type == _REQUEST_RECEIVED and len(message.content.request):
            asked[key] = RecordedCalibration(message.content.request[0], message.logged_ns)
        elif info.event_type == _RESPONSE_SENT and len(message.content.response) and key in asked:
            _add_answer(asked[key], message.content.response[0], bag)
    if not asked:
        raise DataError(f"{bag}: it holds no request of a calibration; were the Services told with their contents?")
    return list(asked.values())


def _add_answer(call: RecordedCalibration, response: Any, bag: Path) -> None:
    if not response.success:
        call.refusal = str(response.status.message)
        return
    try:
        report = decode_json(response.report.json)
    except JsonError as error:
        raise DataError(f"{bag}: the report of a calibration cannot be read: {error.sentence}") from error
    if isinstance(report, dict):
        call.report = report


def image_sizes(bag: Path, call: RecordedCalibration, cameras: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Return width and height of the images of cameras [px], by the recorded report, or else by the camera infos.

    Raises:
        DataError: Nothing in the bag says it of a camera.
    """
    sizes = call.image_sizes()
    topics = topics_of(bag)
    for camera in cameras:
        topic = f"/{camera}/camera_info"
        if camera not in sizes and topics.get(topic) == CAMERA_INFO:
            info = next(messages_of(bag, {topic: (CAMERA_INFO,)}), None)
            if info is not None:
                sizes[camera] = int(info.content.width), int(info.content.height)
        if camera not in sizes:
            raise DataError(f"{bag}: neither a report nor {topic} says how large the images of {camera} are")
    return {camera: sizes[camera] for camera in cameras}


@dataclass(frozen=True)
class FoundAgain:
    """Observations with spots found anew.

    Attributes:
        request: The request with them.
        found: Spots that were found.
        lost: Spots of the recorded request that were not found now.
        missing: Looks whose images are not in the bag; they are left out.
        moved_px: How far a spot that was found both times moved at most [px].
    """

    request: CalibrateRequest
    found: int
    lost: int
    missing: int
    moved_px: float


def find_again(
    bag: Path,
    call: RecordedCalibration,
    request: CalibrateRequest,
    settings: VssSettings,
    progress: Callable[[str], None],
) -> FoundAgain:
    """Find the spots of a request in the recorded images, in the looks of the observations.

    Args:
        bag: The bag.
        call: As it was recorded.
        request: Its request, with the cameras of interest.
        settings: Noise of the sensors, and what a spot must be like.
        progress: Is told how far it is.

    Raises:
        DataError: The bag cannot be read, or holds none of the images.
    """
    looked = {
        (str(spot.camera), _stamp(spot)): i
        for i, observation in enumerate(call.request.observations)
        for spot in observation.spots
        if spot.camera in request.cameras
    }
    discs = _search_discs(bag)
    spots: list[dict[str, SeenSpot]] = [{} for _ in request.observations]
    seen: set[tuple[str, int]] = set()
    for camera in request.cameras:
        stamps = {stamp for name, stamp in looked if name == camera}
        for stamp, off, on in _pairs(bag, camera, stamps):
            seen.add((camera, stamp))
            finding = find_spot(on, off, settings.sensor, settings.spot, discs.get((camera, stamp)))
            if (spot := finding.spot) is not None:
                spots[looked[camera, stamp]][camera] = SeenSpot(np.array([spot.u, spot.v]), spot.covariance, stamp)
            progress(f"{len(seen)} of {len(looked)} pairs of images")
    if not seen:
        topics = ", ".join(f"/{camera}/image_raw" for camera in request.cameras)
        raise DataError(f"{bag}: the images of its {len(looked)} looks are not in it ({topics}); were they recorded?")
    return _counted(request, spots, len(looked) - len(seen))


def _counted(request: CalibrateRequest, spots: Sequence[dict[str, SeenSpot]], missing: int) -> FoundAgain:
    lost, moved = 0, 0.0
    observations: list[Observation] = []
    for observation, found in zip(request.observations, spots, strict=True):
        before = {name: spot for name, spot in observation.spots.items() if name in request.cameras}
        lost += len(before.keys() - found.keys())
        for name in before.keys() & found.keys():
            moved = max(moved, float(np.linalg.norm(found[name].uv - before[name].uv)))
        observations.append(replace(observation, spots=found))
    count = sum(len(found) for found in spots)
    return FoundAgain(replace(request, observations=tuple(observations)), count, lost, missing, moved)


def _search_discs(bag: Path) -> dict[tuple[str, int], SearchDisc]:
    """Where each look was confined to, by camera and stamp of the exposure."""
    if LOOKS not in topics_of(bag):
        return {}
    return {
        (str(each.camera), _stamp(each)): SearchDisc(each.u, each.v, each.radius)
        for message in messages_of(bag, {LOOKS: (LOOK,)}, FIELDS)
        for response in message.content.response
        for each in response.candidates
        if each.predicted
    }


def _pairs(bag: Path, camera: str, stamps: set[int]) -> Iterator[tuple[int, Any, Any]]:
    """Yield stamp, image without light and image with light, of each look of a camera with images in the bag."""
    topic = f"/{camera}/image_raw"
    if topic not in topics_of(bag):
        return
    before: tuple[int, Any] | None = None
    for message in messages_of(bag, {topic: (IMAGE,)}):
        stamp, image = _stamp(message.content.header), _pixels(message.content, topic)
        follows = before is not None and before[0] not in stamps and 0 < stamp - before[0] < _PAIR_NS
        if stamp in stamps and follows and before is not None and before[1].shape == image.shape:
            yield stamp, before[1], image
        before = stamp, image


def _pixels(image: Any, topic: str) -> Any:
    fits = len(image.data) == image.height * image.step and image.step >= image.width
    if image.encoding != "mono8" or not fits or min(image.width, image.height) < 1:
        raise DataError(f"{topic}: an image of {len(image.data)} bytes, {image.encoding}; mono8 is needed", topic=topic)
    return np.ascontiguousarray(np.frombuffer(image.data, np.uint8).reshape(image.height, -1)[:, : image.width])


def _stamp(message: Any) -> int:
    return int(message.stamp.sec) * 10**9 + int(message.stamp.nanosec)


def mount_in(
    bag: Path, until_ns: int, wrist: Callable[[dict[str, Any], str, int], Pose | None], freshness_ns: float
) -> Mount:
    """Where frames of the robot were when cameras were exposed, by the transforms of the bag.

    Args:
        bag: The bag.
        until_ns: Time of recording after which transforms are too late [ns]: the testbed's time may begin again.
        wrist: Where the transforms of a message, by the frames that they are of, put the wrist of a side at a testbed
            time [ns]; it may take them out.
        freshness_ns: How far the stamps of transforms may be from that time [ns].
    """

    def mount(frame: str, stamps_ns: Sequence[int]) -> Pose:
        side, found = frame.removesuffix("_wrist"), dict[int, Pose]()
        if "/tf" not in topics_of(bag):
            raise StateError(f"{bag}: a camera is fixed to {frame}, and no transforms say where that was")
        for message in messages_of(bag, {"/tf": (TRANSFORMS,)}):
            if message.logged_ns > until_ns:
                break
            tree = {each.child_frame_id: each for each in message.content.transforms}
            told = {_stamp(each.header) for each in tree.values()}
            for stamp in stamps_ns:
                near = any(abs(stamp - when) <= freshness_ns for when in told)
                if near and (pose := wrist(dict(tree), side, stamp)) is not None:
                    found[stamp] = pose
        return at_rest(frame, [found[stamp] for stamp in stamps_ns if stamp in found])

    return mount
