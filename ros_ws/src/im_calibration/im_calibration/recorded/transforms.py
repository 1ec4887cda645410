"""Frames that move in each other: transforms, joints of a robot, poses of a file, interpolated in time."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from im_bag.reading import messages_of, topics_of
from im_calibration.recorded.stamps import Stamps, stamp_of
from im_cell.robot.description import UrdfJoint, parse_description
from im_cell.rotations import cross_matrix, matrix_of_quaternion, matrix_of_rpy
from im_core.errors import DataError, nearest
from im_core.files import read_text

Array = NDArray[np.float64]

TF, TF_STATIC, JOINT_STATES = "/tf", "/tf_static", "/joint_states"
TF_TYPE, _JOINT_STATE = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState"
_WIDEST_GAP_NS, _NEAR_NS = 500_000_000, 20_000_000
"""Between samples farther apart nothing is interpolated; a sample is valid so long before and after."""
_BEYOND_RAD = 0.5
"""How far beyond the limits of its joint a real angle may be: limits of a description are those of the motion."""
_WORDS_TUM = 8


@dataclass(frozen=True)
class TransformTrack:
    """Pose of a frame in its parent over time.

    Attributes:
        parent: The parent.
        stamps: Of the samples, ascending, shape (m,) [ns]; empty: the frame is fixed.
        poses: Returns the pose at some stamps, shape (k,) [ns] -> (k, 4, 4), by interpolation.
    """

    parent: str
    stamps: Stamps
    poses: Callable[[Stamps], Array]

    def known(self, stamps: Stamps) -> NDArray[np.bool_]:
        """Return at which stamps samples are near enough, shape (k,)."""
        if not len(self.stamps):
            return np.ones(len(stamps), dtype=bool)
        after = np.searchsorted(self.stamps, stamps)
        to_next = self.stamps[np.minimum(after, len(self.stamps) - 1)] - stamps
        to_last = stamps - self.stamps[np.maximum(after - 1, 0)]
        between = (after > 0) & (after < len(self.stamps)) & (to_next + to_last <= _WIDEST_GAP_NS)
        return np.asarray(between | (np.minimum(np.abs(to_next), np.abs(to_last)) <= _NEAR_NS))


class TransformTree:
    """Frames with the track of each in its parent.

    Args:
        tracks: By frame.
        source: Where they are from, for errors.
    """

    def __init__(self, tracks: Mapping[str, TransformTrack], source: str) -> None:
        self._tracks, self._source = tracks, source

    def stamps(self, base: str, tool: str) -> Stamps:
        """Return the stamps of all samples between two frames, shape (m,) [ns].

        Raises:
            DataError: The frames are not connected.
        """
        up, down = self._way(base, tool)
        every = [self._tracks[frame].stamps for frame in (*up, *down)]
        return np.unique(np.concatenate([np.empty(0, dtype=np.int64), *every]))

    def poses(self, base: str, tool: str, stamps: Stamps) -> Array:
        """Return poses of a frame in another one, NaN where unknown, shape (k, 4, 4).

        Args:
            base: The frame in which they are.
            tool: The frame of which they are.
            stamps: When, shape (k,) [ns].

        Raises:
            DataError: The frames are not connected.
        """
        up, down = self._way(base, tool)
        poses, base_poses = (self._climbed(way, stamps) for way in (up, down))
        return np.asarray(np.linalg.inv(base_poses) @ poses)

    def _climbed(self, way: list[str], stamps: Stamps) -> Array:
        poses = np.broadcast_to(np.eye(4), (len(stamps), 4, 4)).copy()
        for frame in way:
            track = self._tracks[frame]
            poses = track.poses(stamps) @ poses
            poses[~track.known(stamps)] = np.nan
        return poses

    def _way(self, base: str, tool: str) -> tuple[list[str], list[str]]:
        """Return the frames from the tool and from the base up to the first common one, without it."""
        ways = [self._ancestors(frame) for frame in (tool, base)]
        shared = [frame for frame in ways[0] if frame in ways[1]]
        if not shared:
            known = self._tracks.keys() | {track.parent for track in self._tracks.values()}
            lost = next((frame for frame in (base, tool) if frame not in known), "")
            hint = f"there is no frame '{lost}'{nearest(lost, known)}" if lost else "nothing connects them"
            raise DataError(f"{self._source}: does not say where '{tool}' is in '{base}': {hint}.")
        up, down = (way[: way.index(shared[0])] for way in ways)
        return up, down

    def _ancestors(self, frame: str) -> list[str]:
        way = [frame]
        while frame in self._tracks and self._tracks[frame].parent not in way:
            frame = self._tracks[frame].parent
            way.append(frame)
        return way


def tree_of_bag(bag: Path, topic: str = TF) -> TransformTree:
    """Read the transforms of a bag, of a topic and of ``/tf_static``.

    Raises:
        DataError: The bag cannot be read, or has no such topic.
    """
    rows: dict[str, list[tuple[int, list[float]]]] = {}
    parents: dict[str, str] = {}
    fixed = {TF_STATIC} & topics_of(bag).keys()
    tracks: dict[str, TransformTrack] = {}
    for message in messages_of(bag, dict.fromkeys({topic, *fixed}, (TF_TYPE,))):
        for each in message.content.transforms:
            child, parent, move = each.child_frame_id.lstrip("/"), each.header.frame_id.lstrip("/"), each.transform
            shift, turn = move.translation, move.rotation
            row = [shift.x, shift.y, shift.z, turn.x, turn.y, turn.z, turn.w]
            if not np.isfinite(row).all():
                continue
            if message.topic in fixed:
                tracks[child] = _interpolated(parent, [(0, row)], _rotation_of(bag, child))
            elif parents.setdefault(child, parent) == parent:
                stamp = stamp_of(each.header)
                rows.setdefault(child, []).append((stamp or message.logged_ns, row))
            else:
                raise DataError(f"{bag}: '{child}' has two parents, '{parents[child]}' and '{parent}'.")
    for child, samples in rows.items():
        tracks[child] = _interpolated(parents[child], samples, _rotation_of(bag, child))
    return TransformTree(tracks, str(bag))


def tree_of_joints(bag: Path, urdf: Path) -> TransformTree:
    """Return the links of a robot by its joint states in a bag; a message may hold some of the joints.

    Raises:
        DataError: The bag cannot be read, has no such topic, or has angles far beyond the limits of their joint.
        ConfigError: The description cannot be read.
    """
    description = parse_description(read_text(urdf), str(urdf))
    samples: dict[str, list[tuple[int, float]]] = {}
    for message in messages_of(bag, {JOINT_STATES: (_JOINT_STATE,)}):
        stamp = stamp_of(message.content.header)
        for name, value in zip(message.content.name, message.content.position, strict=False):
            if np.isfinite(value):
                samples.setdefault(name, []).append((stamp or message.logged_ns, float(value)))
    for joint in description.joints:
        _check_angles(joint, samples.get(joint.name, []), f"{bag}: {JOINT_STATES}")
    return TransformTree(dict(_link_tracks(description.joints, samples)), f"{urdf} with {JOINT_STATES} of {bag}")


def _check_angles(joint: UrdfJoint, samples: list[tuple[int, float]], source: str) -> None:
    """Check that angles of a joint are radians, by the joint's limits.

    Raises:
        DataError: One is far beyond the limits.
    """
    if joint.kind != "revolute" or joint.lower is None or joint.upper is None:
        return
    for _, angle in samples:
        if not joint.lower - _BEYOND_RAD < angle < joint.upper + _BEYOND_RAD:
            raise DataError(
                f"{source} has {joint.name} at {angle:.4g} rad, its limits are {joint.lower:.4g} and "
                f"{joint.upper:.4g} rad; are the states in degrees?",
                joint=joint.name,
            )


def tree_of_file(path: Path, base: str, tool: str) -> TransformTree:
    """Read a trajectory: lines of a stamp [s], a place and a quaternion x, y, z, w, as of TUM's RGB-D benchmark.

    Raises:
        DataError: The file cannot be read, or a line is none.
    """
    samples = list[tuple[int, list[float]]]()
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if words and (len(values) != _WORDS_TUM or not np.isfinite(values).all()):
            raise DataError(f"{path}:{number}: is no stamp [s], x, y, z and quaternion x, y, z, w.", file=str(path))
        if words:
            seconds, _, parts = words[0].partition(".")  # a stamp has more digits than a float
            plain = seconds.isdecimal() and (not parts or parts.isdecimal())
            stamp = int(seconds) * 10**9 + int(parts[:9].ljust(9, "0")) if plain else round(values[0] * 1e9)
            samples.append((stamp, values[1:]))
    if not samples:
        raise DataError(f"{path}: holds no poses.", file=str(path))
    return TransformTree({tool: _interpolated(base, samples, f"{path}: a quaternion")}, str(path))


def _rotation_of(bag: Path, frame: str) -> str:
    return f"{bag}: the rotation of '{frame}'"


def _interpolated(parent: str, samples: list[tuple[int, list[float]]], whose: str) -> TransformTrack:
    """Return a track through poses, turned along the chord of quaternions; one alone is fixed, of stamp 0."""
    stamps, rows = _ordered(samples)
    turns = rows[:, 3:].copy()
    matrix_of_quaternion(turns, whose)
    flips = np.cumprod(np.append(1.0, np.where(np.sum(turns[1:] * turns[:-1], axis=1) < 0.0, -1.0, 1.0)))
    turns *= flips[:, None]

    def poses(at: Stamps) -> Array:
        values = _between(stamps, np.hstack((rows[:, :3], turns)), at)
        result = np.broadcast_to(np.eye(4), (len(at), 4, 4)).copy()
        result[:, :3, 3] = values[:, :3]
        result[:, :3, :3] = matrix_of_quaternion(values[:, 3:] / np.linalg.norm(values[:, 3:], axis=1, keepdims=True))
        return result

    return TransformTrack(parent, stamps[stamps > 0], poses)


def _link_tracks(
    joints: tuple[UrdfJoint, ...], samples: Mapping[str, list[tuple[int, float]]]
) -> Iterator[tuple[str, TransformTrack]]:
    """Yield the track of the child of each fixed or known joint; others connect nothing."""
    for joint in joints:
        if joint.kind != "fixed" and joint.name not in samples:
            continue
        told = samples.get(joint.name, [(0, 0.0)]) if joint.kind != "fixed" else [(0, 0.0)]
        stamps, values = _ordered([(stamp, [value]) for stamp, value in told])
        yield joint.child, TransformTrack(joint.parent, stamps[stamps > 0], _joint_poses(joint, stamps, values))


def _joint_poses(joint: UrdfJoint, stamps: Stamps, values: Array) -> Callable[[Stamps], Array]:
    origin = np.eye(4)
    origin[:3, :3], origin[:3, 3] = matrix_of_rpy(joint.rpy), joint.xyz
    axis = np.array(joint.axis)
    cross = cross_matrix(axis)

    def poses(at: Stamps) -> Array:
        q = _between(stamps, values, at)[:, 0]
        moved = np.broadcast_to(np.eye(4), (len(at), 4, 4)).copy()
        if joint.kind == "prismatic":
            moved[:, :3, 3] = q[:, None] * axis
        else:
            moved[:, :3, :3] += np.sin(q)[:, None, None] * cross + (1.0 - np.cos(q))[:, None, None] * (cross @ cross)
        return np.asarray(origin @ moved)

    return poses


def _ordered(samples: list[tuple[int, list[float]]]) -> tuple[Stamps, Array]:
    """Return stamps, ascending and each once, and values of samples."""
    stamps, first = np.unique(np.array([stamp for stamp, _ in samples], dtype=np.int64), return_index=True)
    return stamps, np.array([values for _, values in samples], dtype=float)[first]


def _between(stamps: Stamps, values: Array, at: Stamps) -> Array:
    """Interpolate values, shape (m, d), linearly, and hold those at the ends, shape (k, d)."""
    after = np.clip(np.searchsorted(stamps, at), 1, max(1, len(stamps) - 1))
    if len(stamps) == 1:
        return np.repeat(values, len(at), axis=0)
    share = np.clip((at - stamps[after - 1]) / (stamps[after] - stamps[after - 1]), 0.0, 1.0)[:, None]
    return np.asarray((1.0 - share) * values[after - 1] + share * values[after])
