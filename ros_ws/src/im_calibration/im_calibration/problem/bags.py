"""Reader of bags: data sets of spots and poses, paired by stamps, of any origin; recorded calibrations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_bag.reading import BagMessage, messages_of, topics_of
from im_calibration.problem.convert import dataset_head
from im_calibration.recorded.stamps import moments, stamp_of
from im_calibration.recorded.transforms import TF_TYPE, tree_of_bag
from im_cell.lens import LENSES, PLUMB_BOB
from im_cell.rotations import matrix_of_quaternion
from im_core.errors import DataError
from im_core.text.jsontext import JsonError, decode_json

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_POINT, _POSE = "geometry_msgs/msg/PointStamped", "geometry_msgs/msg/PoseStamped"
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_CALLS, _CALL = "/vss/calibrate/_service_event", "im_msgs/srv/Calibrate_Event"
_REQUEST_RECEIVED, _RESPONSE_SENT = 1, 2
#: What is read of the messages of this workspace.
_FIELDS = {
    "im_msgs/srv/Calibrate_Request": ("cameras", "observations", "known_lengths", "directory", "apply"),
    "im_msgs/srv/Calibrate_Response": ("success", "status", "report"),
    "im_msgs/msg/CalibrationReport": ("json",),
    "im_msgs/msg/KnownLength": ("length", "sd", "first", "second"),
    "im_msgs/msg/Observation": ("pose", "wrist", "position_covariance", "spots"),
    "im_msgs/msg/Spot": ("camera", "stamp", "found", "u", "v", "covariance"),
    "im_msgs/msg/Status": ("message",),
}


@dataclass(frozen=True)
class BagTopics:
    """Roles of the topics of a bag.

    Attributes:
        spots: Topic of the spots of each camera: ``geometry_msgs/PointStamped``, x and y in pixels.
        poses: Topic of the tool, ``geometry_msgs/PoseStamped``, or of the light, ``geometry_msgs/PointStamped``, or of
            transforms, ``tf2_msgs/TFMessage``.
        frames: Of the transforms: the base and the tool; None for other topics.
        infos: Topic of the ``sensor_msgs/CameraInfo`` of each camera; those not in it: beside the spots, if there.
    """

    spots: Mapping[str, str]
    poses: str
    frames: tuple[str, str] | None
    infos: Mapping[str, str]


@dataclass(frozen=True)
class Pairing:
    """Spots with the matching poses.

    Attributes:
        pose_of: Which pose each place of the data set is, shape (n,).
        spot_of: Which spot of each camera, shape (c, n); -1: none.
        left_out: Spots with no pose within the tolerance, and those that another one was nearer to.
        apart_s: Largest distance in time of a spot and its pose [s].
    """

    pose_of: NDArray[np.intp]
    spot_of: NDArray[np.intp]
    left_out: int
    apart_s: float


@dataclass(frozen=True)
class BagDataSet:
    """A data set from a bag.

    Attributes:
        content: The data set.
        pairing: How its spots were paired.
        moved_m: How far the light moved between a spot and its pose at most [m].
        lenses: Lens models that the bag tells and that are not known, by camera; `plumb_bob` is in their place.
    """

    content: dict[str, Any]
    pairing: Pairing
    moved_m: float
    lenses: Mapping[str, str]


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

    def led_offset(self) -> tuple[tuple[float, float, float], float] | None:
        """Return the light's nominal place in the wrist frame and the prior deviation [m]; None: not in the answer."""
        match self.report:
            case {
                "led_offset_nominal_m": [float() | int() as x, float() | int() as y, float() | int() as z],
                "led_offset_prior_sd_m": float() | int() as deviation,
            }:
                return (x, y, z), deviation
        return None


@dataclass(frozen=True)
class _Track:
    """Values over time: stamps, shape (m,) [ns]; positions, shape (m, 3) [m]; rotations, shape (m, 3, 3)."""

    stamps: Stamps
    positions: Array
    rotations: Array | None = None


def dataset_from_bag(
    bag: Path,
    topics: BagTopics,
    *,
    tolerance_s: float,
    led_offset: Array | None,
    led_offset_sd: float | None,
    image_size: tuple[int, int] | None,
    sigma_px: float | None,
    sigma_m: float | None,
) -> BagDataSet:
    """Build a data set from the spots in a bag; each spot goes with the pose of the nearest stamp.

    Args:
        bag: The bag.
        topics: What of it is what.
        tolerance_s: Largest distance of the stamps of a spot and its pose, and of the spots of one pose [s].
        led_offset: The light in the frame of the tool, shape (3,) [m]; None: the poses are those of the light.
        led_offset_sd: How well it is known, each axis [m]; None: it is exact.
        image_size: Width and height of images of which the bag has no camera info [px].
        sigma_px: Standard deviation of each image coordinate [px]; None: not known.
        sigma_m: Standard deviation of each coordinate of the positions [m]; None: not known, 0: exact.

    Raises:
        DataError: The bag cannot be read, lacks a topic, or what is in it does not go together; one sentence.
    """
    seen = {name: _track(bag, topic, (_POINT,)) for name, topic in topics.spots.items()}
    if topics.frames is None and topics_of(bag).get(topics.poses) == TF_TYPE:
        raise DataError(f"{bag}: '{topics.poses}' has transforms; give --frames BASE TOOL, between which frames.")
    tool = _transforms(bag, topics) if topics.frames else _track(bag, topics.poses, (_POSE, _POINT))
    light = tool.positions
    if led_offset is not None or led_offset_sd is not None:
        if tool.rotations is None:
            raise DataError(f"{bag}: '{topics.poses}' has points; an LED offset needs poses, which turn.")
        light = light + tool.rotations @ (np.zeros(3) if led_offset is None else led_offset)
    pairing = pair([track.stamps for track in seen.values()], tool.stamps, tolerance_s)
    if not len(pairing.pose_of):
        span = (min(track.stamps[0] for track in seen.values()) - tool.stamps[0]) * 1e-9
        late = f"the first spot comes {span:.3f} s after the first pose"
        raise DataError(f"{bag}: no spot has a pose within {tolerance_s:g} s; {late}.")
    beside = {name: f"{topic.rpartition('/')[0]}/camera_info" for name, topic in topics.spots.items()}
    infos = _camera_infos(bag, beside, topics.infos)
    sizes = {name: infos[name][0] if name in infos else image_size for name in seen}
    content = dataset_head(sizes, len(pairing.pose_of), sigma_px, sigma_m)
    lenses = {name: infos[name][1] if name in infos else PLUMB_BOB.name for name in seen}
    if infos:
        content["distortion_model"] = [lens if lens in LENSES else PLUMB_BOB.name for lens in lenses.values()]
    if tool.rotations is not None:
        content["wrist_R_base"] = tool.rotations[pairing.pose_of].tolist()
    numbers = _readings(tool, pairing.pose_of)
    if numbers[-1] < len(numbers):
        content["reading"] = list(map(str, numbers))
    if led_offset_sd is not None:
        content |= {"led_offset_nominal_known": False, "led_offset_prior_sd_m": led_offset_sd}
    spots = [
        [None if i < 0 else track.positions[i, :2].tolist() for i in of]
        for track, of in zip(seen.values(), pairing.spot_of, strict=True)
    ]
    content["trials"] = [{"x_base_m": light[pairing.pose_of].tolist(), "u_px": spots}]
    unknown = {name: lens for name, lens in lenses.items() if lens not in LENSES}
    return BagDataSet(content, pairing, _moved(light, tool.stamps, pairing), unknown)


def pair(spots: list[Stamps], poses: Stamps, tolerance_s: float) -> Pairing:
    """Pair simultaneous spots of several cameras, and give each the pose nearest in time.

    Args:
        spots: Of each camera, ascending, shape (k,) each [ns].
        poses: Ascending, shape (m,) [ns].
        tolerance_s: Largest distance of what belongs together [s].
    """
    tolerance, groups = round(tolerance_s * 1e9), moments(spots, tolerance_s)
    best: dict[int, tuple[int, dict[int, tuple[int, int]]]] = {}
    for group in groups:
        middle = sum(stamp for stamp, _ in group.values()) // len(group)
        after = int(np.searchsorted(poses, middle))
        nearest = min((k for k in (after - 1, after) if 0 <= k < len(poses)), key=lambda k: abs(int(poses[k]) - middle))
        apart = max(abs(int(poses[nearest]) - stamp) for stamp, _ in group.values())
        if apart <= tolerance and (nearest not in best or apart < best[nearest][0]):
            best[nearest] = (apart, group)
    pose_of = np.array(sorted(best), dtype=np.intp)
    spot_of = np.full((len(spots), len(pose_of)), -1, dtype=np.intp)
    for column, k in enumerate(pose_of):
        for camera, (_, i) in best[int(k)][1].items():
            spot_of[camera, column] = i
    return Pairing(
        pose_of,
        spot_of,
        left_out=sum(map(len, spots)) - int((spot_of >= 0).sum()),
        apart_s=max((apart for apart, _ in best.values()), default=0) * 1e-9,
    )


def _readings(tool: _Track, pose_of: NDArray[np.intp]) -> list[int]:
    """Number the readings of the robot from 1: successive poses that are the same to the last digit are one."""
    values = tool.positions if tool.rotations is None else np.dstack((tool.rotations, tool.positions[..., None]))
    values = values[pose_of].reshape(len(pose_of), -1)
    return [1, *(1 + np.cumsum(np.any(np.diff(values, axis=0) != 0.0, axis=1))).tolist()]


def _moved(light: Array, stamps: Stamps, pairing: Pairing) -> float:
    """Return the light's move in the longest time between a spot and the pose, from the poses before and after [m]."""
    if len(light) < 2:
        return 0.0
    lasted = np.maximum(np.diff(stamps), 1) * 1e-9
    speed = np.linalg.norm(np.diff(light, axis=0), axis=1) / lasted
    around = np.maximum(np.append(speed, 0.0), np.insert(speed, 0, 0.0))
    return float(around[pairing.pose_of].max() * pairing.apart_s)


def _track(bag: Path, topic: str, types: tuple[str, ...]) -> _Track:
    """Read points or poses over time, by stamps, or by time of recording if none is stamped.

    Those that are not finite were not measured.
    """
    found = list(messages_of(bag, {topic: types}))
    if not found:
        raise DataError(f"{bag}: there is nothing on topic '{topic}' in it.", topic=topic)
    frames = {message.content.header.frame_id for message in found}
    if len(frames) > 1:
        raise DataError(f"{bag}: '{topic}' is in several frames: {', '.join(sorted(frames))}; one is needed.")
    stamps = [stamp_of(message.content.header) for message in found]
    if any(stamps) and not all(stamps):
        raise DataError(f"{bag}: {stamps.count(0)} of {len(stamps)} messages on '{topic}' have no stamp.", topic=topic)
    if not any(stamps):
        stamps = [message.logged_ns for message in found]
    rows = np.array([_row(message) for message in found]).reshape(len(found), -1)
    times = np.array(stamps, dtype=np.int64)
    order = [i for i in np.argsort(times, kind="stable") if np.isfinite(rows[i]).all()]
    if not order:
        raise DataError(f"{bag}: topic '{topic}' has no message with finite numbers.", topic=topic)
    whose = f"{bag}: the orientation of '{topic}'"
    turns = matrix_of_quaternion(rows[order, 3:], whose) if rows.shape[1] > 3 else None
    return _Track(times[order], rows[order, :3], turns)


def _row(message: BagMessage) -> list[float]:
    content = message.content
    if message.type == _POINT:
        return _vector(content.point)
    return _vector(content.pose.position) + _quaternion(content.pose.orientation)


def _transforms(bag: Path, topics: BagTopics) -> _Track:
    """Return the tool's pose in the base at each transform that moves the tool."""
    assert topics.frames is not None
    tree = tree_of_bag(bag, topics.poses)
    stamps = tree.stamps(*topics.frames)
    poses = tree.poses(*topics.frames, stamps)
    known = np.isfinite(poses[:, 0, 0])
    if not known.any():
        raise DataError(f"{bag}: '{topics.poses}' does not move '{topics.frames[1]}' in '{topics.frames[0]}'.")
    return _Track(stamps[known], poses[known, :3, 3], poses[known, :3, :3])


def recorded_calibrations(bag: Path) -> list[RecordedCalibration]:
    """Return the calibrations of a bag, in the order of the requests.

    Raises:
        DataError: It cannot be read, or holds none.
    """
    if _CALLS not in topics_of(bag):
        raise DataError(f"{bag}: it holds no calibration, there is no topic {_CALLS} in it", topic=_CALLS)
    asked: dict[tuple[bytes, int], RecordedCalibration] = {}
    for message in messages_of(bag, {_CALLS: (_CALL,)}, _FIELDS):
        event = message.content
        key = bytes(bytearray(event.info.client_gid)), int(event.info.sequence_number)
        if event.info.event_type == _REQUEST_RECEIVED and len(event.request):
            asked[key] = RecordedCalibration(event.request[0], message.logged_ns)
        elif event.info.event_type == _RESPONSE_SENT and len(event.response) and key in asked:
            _add_answer(asked[key], event.response[0], bag)
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


def recorded_sizes(bag: Path, call: RecordedCalibration, cameras: Sequence[str]) -> dict[str, tuple[int, int]]:
    """Return width and height of the images of cameras [px], by the recorded report, or else by the camera infos.

    Raises:
        DataError: Nothing in the bag says it of a camera.
    """
    sizes: dict[str, tuple[int, int]] = {}
    told = (call.report or {}).get("cameras")
    for camera in told if isinstance(told, list) else ():
        match camera:
            case {"name": str(name), "width": int(width), "height": int(height)} if min(width, height) > 0:
                sizes[name] = width, height
    infos = {camera: f"/{camera}/camera_info" for camera in cameras if camera not in sizes}
    sizes |= {camera: size for camera, (size, _) in _camera_infos(bag, infos, {}).items()}
    for camera, topic in infos.items():
        if camera not in sizes:
            raise DataError(f"{bag}: neither a report nor {topic} says how large the images of {camera} are")
    return {camera: sizes[camera] for camera in cameras}


def _camera_infos(
    bag: Path, beside: Mapping[str, str], given: Mapping[str, str]
) -> dict[str, tuple[tuple[int, int], str]]:
    """Return image size and lens model by camera: on the given topics, or on those beside, if they are in the bag."""
    have = topics_of(bag)
    chosen = {name: topic for name, topic in beside.items() if have.get(topic) == _CAMERA_INFO} | dict(given)
    found = {}
    for name, topic in chosen.items():
        infos = (message.content for message in messages_of(bag, {topic: (_CAMERA_INFO,)}))
        info = next((each for each in infos if each.width and each.height), None)
        if info is None and name in given:
            raise DataError(f"{bag}: topic '{topic}' says no image size.", topic=topic)
        if info is not None:
            found[name] = _image_size(info), str(info.distortion_model) or PLUMB_BOB.name
    return found


def _image_size(info: Any) -> tuple[int, int]:
    """Return width and height of images [px]: the size at calibration, reduced by region and binning."""
    width, height = info.roi.width or info.width, info.roi.height or info.height
    return int(width) // max(1, int(info.binning_x)), int(height) // max(1, int(info.binning_y))


def _vector(v: Any) -> list[float]:
    return [v.x, v.y, v.z]


def _quaternion(q: Any) -> list[float]:
    return [q.x, q.y, q.z, q.w]
