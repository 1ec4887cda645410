"""Slot data out of a rosbag2, MCAP or SQLite."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_bag.reading import messages_of
from im_core.errors import DataError

_JOINT_STATE = "sensor_msgs/msg/JointState"
_SLOT_STATES = "im_msgs/msg/SlotStates"

Readings = tuple[dict[str, Any], dict[str, Any], dict[str, Any]]
"""Of one message: position by joint, opening and force by gripper, wrench by wrist."""


@dataclass(frozen=True)
class Recording:
    """Readings in the order of time; ``m`` moments, each with the newest of every joint.

    Attributes:
        t: Moments, from 0, shape (m,) [s].
        q: Positions, shape (m, n) [rad or m].
        at: When each was read, shape (m, n) [s]; before ``t`` where a message left the joint out.
        gripper: Openings, shape (m, g) [m].
        gripper_force: Shape (m, g) [N].
        wrench: Shape (m, w, 6) [N, Nm].
    """

    t: NDArray[np.float64]
    q: NDArray[np.float64]
    at: NDArray[np.float64]
    gripper: NDArray[np.float64]
    gripper_force: NDArray[np.float64]
    wrench: NDArray[np.float64]


def load_recording(
    bag: Path, topic: str, joints: Sequence[str], grippers: Sequence[str], wrists: Sequence[str]
) -> Recording:
    """Read ``sensor_msgs/JointState`` or ``im_msgs/SlotStates`` from a bag; joints matched by name.

    Args:
        bag: Folder of the bag.
        topic: E.g. ``/joint_states`` or ``/mcs/slots``.
        joints: Wanted, in their order.
        grippers: Wanted; a topic of joint states has none.
        wrists: Frames of the wanted force-torque sensors; a topic of joint states has none.

    Raises:
        DataError: The bag cannot be read, or lacks the topic, or a name; says what is there. Or the stamps fall, as
            where a testbed was started anew.
    """
    wanted = (tuple(joints), tuple(grippers), tuple(wrists))
    known: dict[tuple[int, str], tuple[int, Any]] = {}
    moments: list[tuple[int, list[tuple[int, Any]]]] = []
    seen: list[set[str]] = [set(), set(), set()]
    messages = list(_messages(bag, topic))
    stamped = any(stamp for stamp, _, _ in messages)
    for stamped_ns, logged_ns, kinds in messages:
        stamp = stamped_ns if stamped else logged_ns
        if moments and stamp < moments[-1][0]:
            raise DataError(
                f"{bag}: the stamps of topic '{topic}' fall from {moments[-1][0] * 1e-9:.3f} to {stamp * 1e-9:.3f} s, "
                f"{(logged_ns - messages[0][1]) * 1e-9:.3f} s after its first message; a bag that is played to a "
                "controller is of one start of a testbed"
            )
        for kind, readings in enumerate(kinds):
            seen[kind] |= readings.keys()
            known.update({(kind, name): (stamp, value) for name, value in readings.items()})
        try:
            moments.append((stamp, [known[kind, name] for kind, names in enumerate(wanted) for name in names]))
        except KeyError:
            continue  # something wanted has not been heard of yet
    for kind, names in enumerate(wanted):
        missing = [name for name in names if name not in seen[kind]]
        if missing:
            has = ", ".join(sorted(seen[kind])) or "none"
            what = ("joint", "gripper", "wrist")[kind]
            raise DataError(f"{bag}: topic '{topic}' says nothing of {what} {', '.join(missing)}; it has {has}")
    if not moments:
        raise DataError(f"{bag}: topic '{topic}' has no moment at which everything wanted is known")
    return _arrays(moments, *map(len, wanted))


def _arrays(moments: list[tuple[int, list[tuple[int, Any]]]], n: int, g: int, w: int) -> Recording:
    m, start = len(moments), moments[0][0]
    values = [[value for _, value in readings] for _, readings in moments]
    pairs = np.array([row[n : n + g] for row in values], dtype=np.float64).reshape(m, g, 2)
    return Recording(
        t=np.array([stamp - start for stamp, _ in moments]) * 1e-9,
        q=np.array([row[:n] for row in values], dtype=np.float64),
        at=np.array([[stamp - start for stamp, _ in readings[:n]] for _, readings in moments]) * 1e-9,
        gripper=pairs[:, :, 0],
        gripper_force=pairs[:, :, 1],
        wrench=np.array([row[n + g :] for row in values], dtype=np.float64).reshape(m, w, 6),
    )


def _messages(bag: Path, topic: str) -> Iterator[tuple[int, int, Readings]]:
    """Yield stamp of the message [ns], time of recording [ns], and readings, message by message."""
    for found in messages_of(bag, {topic: (_JOINT_STATE, _SLOT_STATES)}):
        message = found.content
        stamp = message.header.stamp if found.type == _JOINT_STATE else message.stamp
        yield stamp.sec * 10**9 + stamp.nanosec, found.logged_ns, _readings(message, found.type)


def _readings(message: Any, kind: str) -> Readings:
    if kind == _JOINT_STATE:
        return dict(zip(message.name, message.position.tolist(), strict=False)), {}, {}
    return (
        dict(zip(message.joints, message.position.tolist(), strict=True)),
        dict(
            zip(message.grippers, zip(message.opening.tolist(), message.grip_force.tolist(), strict=True), strict=True)
        ),
        dict(zip(message.wrists, map(_six, message.wrenches), strict=True)),
    )


def _six(wrench: Any) -> list[float]:
    f, t = wrench.force, wrench.torque
    return [f.x, f.y, f.z, t.x, t.y, t.z]
