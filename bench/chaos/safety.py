"""Watches the arms in the testbed's own memory, whoever has died: no leap, and rest where rest is due."""

import threading
from contextlib import ExitStack

import numpy as np

from im_cell.link import HostEnd
from im_cell.robot import load_cell
from im_core import clock, names
from im_core.errors import LinkError

#: How soon after a fault that takes the control away all joints must rest, and for how long that is looked at [s] of
#: testbed time; what counts as rest [rad/s, m/s].
REST_S, LOOK_S, REST = 0.5, 0.2, 0.01
#: How far above its limit a velocity may be before it is a leap: limits hold for setpoints, following has its error.
MARGIN = 1.2
_POLL_S, _AGAIN_S = 0.005, 0.1


class Watch:
    """A thread that reads positions and velocities of all joints; leaves them alone."""

    def __init__(self) -> None:
        cell = load_cell()
        self._names = cell.joint_names
        self._limits = MARGIN * np.array([joint.limits.velocity for joint in cell.joints])
        self._findings: list[str] = []
        self._rest_from: int | None = None
        self._rest_due = False
        self._running = True
        self._thread = threading.Thread(target=self._run, name="safety", daemon=True)

    def expect_rest(self) -> None:
        """From half a second of testbed time after now on, everything must rest for a moment."""
        self._rest_due = True

    def take_findings(self) -> list[str]:
        """What was unsafe since the last call, as sentences."""
        found, self._findings = self._findings, []
        self._rest_from, self._rest_due = None, False
        return found

    def __enter__(self) -> "Watch":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._running = False
        self._thread.join()

    def _run(self) -> None:
        while self._running:
            try:
                with ExitStack() as stack:
                    testbed = stack.enter_context(HostEnd.attach(names.instance(), 0.0))
                    while self._running and testbed.physics_alive():
                        self._look(testbed.tick, testbed.period_s, testbed.read_truth().v)
                        clock.sleep(_POLL_S)
            except LinkError:  # it is being started again
                pass
            self._rest_from, self._rest_due = None, False  # another testbed, at rest
            clock.sleep(_AGAIN_S)

    def _look(self, tick: int, period_s: float, v: np.ndarray) -> None:
        fast = np.flatnonzero(np.abs(v) > self._limits)
        if fast.size:
            told = ", ".join(f"{self._names[rank]} {v[rank]:.2f}" for rank in fast)
            self._findings.append(f"faster than its limit: {told}")
        if self._rest_due:
            self._rest_from, self._rest_due = tick, False
        if self._rest_from is None:
            return
        since_s = (tick - self._rest_from) * period_s
        if REST_S < since_s < REST_S + LOOK_S and np.abs(v).max() > REST:
            rank = int(np.abs(v).argmax())
            self._findings.append(f"{since_s:.2f} s after the fault {self._names[rank]} still moves, {v[rank]:.3f}")
