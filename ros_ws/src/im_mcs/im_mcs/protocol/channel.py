"""Channel between servo process and owner: requests one way; events, samples, a snapshot, evidence the other."""

import numpy as np
from numpy.typing import NDArray

from im_core.shm import MessageRing, Semaphore, SharedBlock, SharedRecord, Snapshot
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.saturation import KINDS
from im_mcs.protocol.evidence import KEPT, record_type
from im_mcs.protocol.heartbeat import OWNER, SERVO, ServoHeartbeat
from im_mcs.protocol.points import packed_size
from im_mcs.protocol.samples import SampleRing, sample_type

# for all requests but the one whose trajectory is the longest that is allowed
_REQUESTS_BYTES = 1 << 20
_EVENTS_BYTES = 1 << 18
_TEXT, _LONG_TEXT = "S64", "S240"


def group_type() -> np.dtype[np.void]:
    """Return the fields of a group in the snapshot; texts are UTF-8, cut to the room."""
    return np.dtype(
        [
            ("name", _TEXT),
            ("state", "<i4"),
            ("reserved", "?"),
            ("owner", _TEXT),
            ("lease_left_s", "<f8"),
            ("lapsed", "?"),
            ("moving", "?"),
            ("paused", "?"),
            ("speed", "<f8"),
            ("controller", "S128"),
            ("late_torques", "<i8"),
            ("protective_stop", _LONG_TEXT),
            ("jog_limit", "<i4"),
        ],
        align=True,
    )


def snapshot_type(config: McsConfig) -> np.dtype[np.void]:
    """Return the fields of the snapshot; arrays over all joints in the order, ``groups`` over the preset in force."""
    joints = (len(config.joint_slots),)
    grippers = (len(config.gripper_slots),)
    most_groups = max(len(groups) for groups in config.presets.values())
    return np.dtype(
        [
            ("tick", "<i8"),
            ("stamp_ns", "<i8"),
            ("state", "<i4"),
            ("power", "?"),
            ("brakes", "?", joints),
            ("reserved", "?", joints),
            ("q", "<f8", joints),
            ("v", "<f8", joints),
            ("tau", "<f8", joints),
            ("setpoint", "<f8", joints),
            ("setpoint_v", "<f8", joints),
            ("setpoint_a", "<f8", joints),
            ("place_s", "<f8", joints),
            ("since_s", "<f8", joints),
            ("age", "<f8", joints),
            ("gripper", "<f8", grippers),
            ("gripper_force", "<f8", grippers),
            ("wrench", "<f8", (len(config.wrench_slots), 6)),
            ("at_rest", "?", joints),
            ("rest_since_tick", "<i8", joints),
            ("rest_window", "<i8", joints),
            ("q_rest", "<f8", joints),
            ("q_rest_variance", "<f8", joints),
            ("preset", _TEXT),
            ("groups", group_type(), (most_groups,)),
            ("saturations", "<i8", (len(KINDS), *joints)),
            ("evidence", "<i8"),
            ("distance", "<f8"),
            ("closest", _TEXT, (2,)),
            ("ticks", "<i8"),
            ("missed_deadlines", "<i8"),
            ("max_lateness_s", "<f8"),
            ("mean_period_s", "<f8"),
            ("mean_compute_s", "<f8"),
            ("real_time", "?"),
            ("linked", "?"),
        ],
        align=True,
    )


def evidence_type(config: McsConfig) -> np.dtype[np.void]:
    """Return the fields of a kept record of evidence."""
    rows = max(1, round(config.safety.record_s / config.servo.period_s))
    return record_type(rows, len(config.joint_slots), len(config.wrench_slots))


def channel_name(instance: str) -> str:
    """Return the name of the channel's memory."""
    return f"{instance}_mcs"


class ServoChannel(SharedRecord):
    """Memory of :func:`channel_name` between the owner, the creator, and the servo.

    Attributes:
        requests: Owner to servo.
        events: Servo to owner: states and replies, never lost; progress, left out when the owner is slow.
        samples: Servo to owner: what the joints do; dropped when the owner is slow.
        snapshot: Newest state; the servo writes.
        bell: Rung by the servo when there are events.
        heartbeat: Heartbeats, both ways.
        evidence: Records of aborts, for :class:`~im_mcs.protocol.evidence.Recorder` and ``Records``.
    """

    SEMAPHORES = ("bell",)

    @staticmethod
    def layout(config: McsConfig) -> np.dtype[np.void]:
        """Return the fields of the channel."""
        longest = packed_size(config.planning.max_trajectory_points, len(config.joint_slots))
        sample = sample_type(len(config.joint_slots), len(config.gripper_slots), len(config.wrench_slots))
        return np.dtype(
            [
                ("requests", MessageRing.layout(_REQUESTS_BYTES + longest)),
                ("events", MessageRing.layout(_EVENTS_BYTES)),
                ("samples", SampleRing.layout(sample)),
                ("snapshot", Snapshot.layout(snapshot_type(config))),
                ("heartbeat", ServoHeartbeat.LAYOUT),
                ("evidence", evidence_type(config), (KEPT,)),
            ],
            align=True,
        )

    def __init__(self, block: SharedBlock, dtype: np.dtype[np.void], semaphores: list[Semaphore]) -> None:
        super().__init__(block, dtype, semaphores)
        self.requests = MessageRing(self.view["requests"], f"{self.name}_requests")
        self.events = MessageRing(self.view["events"], f"{self.name}_events")
        self.samples = SampleRing(self.view["samples"])
        self.snapshot = Snapshot(self.view["snapshot"], f"{self.name}_snapshot")
        (self.bell,) = semaphores
        self.heartbeat = ServoHeartbeat(self.view["heartbeat"], OWNER if block.owned else SERVO)
        self.evidence: NDArray[np.void] = self.view["evidence"]
