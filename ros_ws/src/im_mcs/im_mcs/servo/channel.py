"""What the servo process and its owner share: requests one way, events, samples and a snapshot the other."""

from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from im_core.shm import MessageRing, Semaphore, Snapshot
from im_mcs.state import State

STATES: tuple[State, ...] = tuple(State)
_EVENTS_BYTES = 1 << 18
_SAMPLES_BYTES = 1 << 18


def snapshot_type(n_joints: int, n_grippers: int) -> np.dtype[np.void]:
    """Fields of the snapshot; arrays over all joints in their order."""
    joints = (n_joints,)
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
            ("gripper", "<f8", (n_grippers,)),
            ("at_rest", "?", joints),
            ("rest_since_tick", "<i8", joints),
            ("rest_window", "<i8", joints),
            ("q_rest", "<f8", joints),
            ("q_rest_variance", "<f8", joints),
            ("saturations", "<i8"),
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


class ServoChannel:
    """Shared memory ``<instance>_mcs_*`` between the owner, who creates it, and the servo, who attaches.

    Attributes:
        requests: Owner to servo.
        events: Servo to owner: replies and progress; never lost.
        samples: Servo to owner: joint states; dropped when the owner is slow.
        snapshot: Newest state; the servo writes.
        bell: Rung by the servo when there are events.
    """

    def __init__(
        self, requests: MessageRing, events: MessageRing, samples: MessageRing, snapshot: Snapshot, bell: Semaphore
    ) -> None:
        """Use :meth:`create` or :meth:`attach`."""
        self.requests = requests
        self.events = events
        self.samples = samples
        self.snapshot = snapshot
        self.bell = bell

    @classmethod
    def create(cls, instance: str, n_joints: int, n_grippers: int) -> Self:
        """Create everything, as the owner."""
        prefix = f"{instance}_mcs"
        return cls(
            MessageRing.create(f"{prefix}_requests"),
            MessageRing.create(f"{prefix}_events", _EVENTS_BYTES),
            MessageRing.create(f"{prefix}_samples", _SAMPLES_BYTES),
            Snapshot.create(f"{prefix}_snapshot", snapshot_type(n_joints, n_grippers)),
            Semaphore.create(f"{prefix}_bell"),
        )

    @classmethod
    def attach(cls, instance: str, n_joints: int, n_grippers: int, timeout_s: float) -> Self:
        """Attach to everything, as the servo.

        Raises:
            LinkError: The owner has not created it within ``timeout_s`` [s].
        """
        prefix = f"{instance}_mcs"
        return cls(
            MessageRing.attach(f"{prefix}_requests", timeout_s),
            MessageRing.attach(f"{prefix}_events", timeout_s),
            MessageRing.attach(f"{prefix}_samples", timeout_s),
            Snapshot.attach(f"{prefix}_snapshot", snapshot_type(n_joints, n_grippers), timeout_s),
            Semaphore.attach(f"{prefix}_bell", timeout_s),
        )

    def close(self) -> None:
        """Release everything; the owner removes the names."""
        for part in (self.requests, self.events, self.samples, self.snapshot, self.bell):
            part.close()


def sample_message(
    stamp_ns: int, q: NDArray[np.float64], v: NDArray[np.float64], tau: NDArray[np.float64]
) -> dict[str, Any]:
    """A joint state as JSON data."""
    return {"stamp_ns": stamp_ns, "q": q.tolist(), "v": v.tolist(), "tau": tau.tolist()}
