"""Channel between servo process and owner: requests one way; events, samples, a snapshot, evidence the other."""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from im_core.shm import MessageRing, Semaphore, SharedBlock, Snapshot, dead_owner
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.saturation import KINDS
from im_mcs.protocol.evidence import RecordLayout
from im_mcs.protocol.heartbeat import ServoHeartbeat
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


def record_layout(config: McsConfig) -> RecordLayout:
    """Return the size of the evidence for a configuration."""
    rows = max(1, round(config.safety.record_s / config.servo.period_s))
    return RecordLayout(rows, len(config.joint_slots), len(config.wrench_slots))


class ServoChannel:
    """Shared memory ``<instance>_mcs_*`` between the owner, the creator, and the servo.

    Attributes:
        requests: Owner to servo.
        events: Servo to owner: states and replies, never lost; progress, left out when the owner is slow.
        samples: Servo to owner: what the joints do; dropped when the owner is slow.
        snapshot: Newest state; the servo writes.
        bell: Rung by the servo when there are events.
        heartbeat: Signs of life, both ways.
        evidence: Records of aborts, for :class:`~im_mcs.protocol.evidence.Recorder` and ``Records``.
    """

    def __init__(
        self,
        requests: MessageRing,
        events: MessageRing,
        samples: SampleRing,
        snapshot: Snapshot,
        bell: Semaphore,
        heartbeat: ServoHeartbeat,
        records: SharedBlock,
        layout: RecordLayout,
    ) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.requests = requests
        self.events = events
        self.samples = samples
        self.snapshot = snapshot
        self.bell = bell
        self.heartbeat = heartbeat
        self.layout = layout
        self.evidence: NDArray[np.float64] = records.array("<f8", layout.doubles)
        self._records = records

    @classmethod
    def create(cls, instance: str, config: McsConfig) -> Self:
        """Create everything, as the owner."""
        prefix, layout = f"{instance}_mcs", record_layout(config)
        longest = packed_size(config.planning.max_trajectory_points, len(config.joint_slots))
        records = SharedBlock.create(f"{prefix}_evidence", 8 * layout.doubles)
        records.publish()
        return cls(
            MessageRing.create(f"{prefix}_requests", _REQUESTS_BYTES + longest),
            MessageRing.create(f"{prefix}_events", _EVENTS_BYTES),
            SampleRing.create(f"{prefix}_samples", _sample_type(config)),
            Snapshot.create(f"{prefix}_snapshot", snapshot_type(config)),
            Semaphore.create(f"{prefix}_bell"),
            ServoHeartbeat.create(f"{prefix}_heartbeat"),
            records,
            layout,
        )

    @classmethod
    def attach(cls, instance: str, config: McsConfig, timeout_s: float) -> Self:
        """Attach to everything, as the servo.

        Raises:
            LinkError: The owner has not created it within ``timeout_s`` [s].
        """
        prefix = f"{instance}_mcs"
        return cls(
            MessageRing.attach(f"{prefix}_requests", timeout_s),
            MessageRing.attach(f"{prefix}_events", timeout_s),
            SampleRing.attach(f"{prefix}_samples", _sample_type(config), timeout_s),
            Snapshot.attach(f"{prefix}_snapshot", snapshot_type(config), timeout_s),
            Semaphore.attach(f"{prefix}_bell", timeout_s),
            ServoHeartbeat.attach(f"{prefix}_heartbeat", timeout_s),
            SharedBlock.attach(f"{prefix}_evidence", timeout_s),
            record_layout(config),
        )

    @staticmethod
    def dead_owner(instance: str) -> int:
        """Find the owner process dead in possession of a channel; return 0 if there is none."""
        return dead_owner(f"{instance}_mcs_evidence")

    def close(self) -> None:
        """Release everything; the owner removes the names."""
        for part in (
            self.requests, self.events, self.samples, self.snapshot, self.bell, self.heartbeat, self._records
        ):  # fmt: skip
            part.close()


def _sample_type(config: McsConfig) -> np.dtype[np.void]:
    return sample_type(len(config.joint_slots), len(config.gripper_slots), len(config.wrench_slots))
