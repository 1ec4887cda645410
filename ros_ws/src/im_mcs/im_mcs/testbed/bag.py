"""Channel driver for the replay of recorded slot data, to see again a controller's view."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from im_core.errors import ConfigError, LinkError
from im_mcs.testbed.driver import Drive, Measured
from im_mcs.testbed.recording import load_recording

_ROUNDING_S = 1e-9


class BagDriver:
    """Readings of a bag at the recorded times; commands go nowhere, and count as obeyed.

    Args:
        bag: Folder of a rosbag2, MCAP or SQLite.
        joints: Names in the bag, in the order of the channels.
        topic: Of ``sensor_msgs/JointState`` or ``im_msgs/SlotStates``.
        grippers: Names in the bag, in the order of the channels; only slot states have them.
        wrists: Frames of force-torque sensors; likewise.
        period_s: Time between ticks [s].
        pace: ``recorded``: ticks are a period of wall time apart. ``lockstep``: as fast as the loop goes.
        at_end: ``hold``: the last reading stays, and its age grows. ``fault``: the driver fails.

    Raises:
        ConfigError: The period, pace or end is not one of those allowed.
        DataError: The bag cannot be read, or lacks the topic, or a name.
    """

    interfaces_taken = ("effort", "velocity", "position")

    def __init__(
        self,
        bag: str,
        joints: Sequence[str],
        topic: str = "/joint_states",
        grippers: Sequence[str] = (),
        wrists: Sequence[str] = (),
        period_s: float = 0.0045,
        pace: Literal["recorded", "lockstep"] = "recorded",
        at_end: Literal["hold", "fault"] = "hold",
    ) -> None:
        for name, value, allowed in (("pace", pace, ("recorded", "lockstep")), ("at_end", at_end, ("hold", "fault"))):
            if value not in allowed:
                raise ConfigError(f"{name} of the driver of bag '{bag}' is '{value}', not {' or '.join(allowed)}")
        if not period_s > 0.0:
            raise ConfigError(f"period_s of the driver of bag '{bag}' is {period_s}, not > 0 [s]")
        self._bag, self._topic = bag, topic
        self._recording = load_recording(Path(bag), topic, joints, grippers, wrists)
        self.n_joints, self.n_grippers, self.n_wrenches = len(joints), len(grippers), len(wrists)
        self.period_s = period_s
        self.wall_period_s = period_s if pace == "recorded" else 0.0
        self._ends_in_fault = at_end == "fault"
        self._tick = 0
        self._drive = Drive(
            np.zeros(self.n_joints), False, np.ones(self.n_joints, dtype=np.bool_), np.zeros(self.n_grippers), False,
            np.zeros(self.n_grippers),
        )  # fmt: skip

    def connect(self) -> None:
        """Nothing to reach."""

    def wait(self, timeout_s: float) -> bool:
        """Return at once: the next tick is there as soon as the loop has kept the pace."""
        return True

    def read(self) -> Measured:
        """The newest readings at the time of the tick.

        Raises:
            LinkError: The bag has ended, and that is a fault.
        """
        r, t = self._recording, self._tick * self.period_s
        if self._ends_in_fault and t > r.t[-1] + _ROUNDING_S:
            raise LinkError(
                f"bag ended: '{self._bag}' has nothing on '{self._topic}' after {r.t[-1]:.3f} s", seconds=float(r.t[-1])
            )
        i = int(np.searchsorted(r.t, t + _ROUNDING_S, side="right")) - 1
        drive = self._drive
        return Measured(
            self._tick, round(t * 1e9), r.q[i].copy(), drive.power, drive.brakes | (not drive.power),
            r.gripper[i].copy(), np.maximum(t - r.at[i], 0.0), r.wrench[i].copy(), r.gripper_force[i].copy(),
        )  # fmt: skip

    def write(self, drive: Drive) -> None:
        """Let one period pass."""
        self._drive = drive
        self._tick += 1

    def after_tick(self, tick: int) -> None:
        """Nothing to wait for."""

    def close(self) -> None:
        """Nothing to leave."""
