"""Missed deadlines of the servo in real time: nodes publish, a camera renders, 18 joints move."""

import json
import tempfile
from pathlib import Path
from typing import Any

import rclpy
from rclpy.signals import SignalHandlerOptions
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectoryPoint

from bench.figures import Line
from im_bringup.machine import stop
from im_bringup.machine.start import start
from im_bringup.tasks import deployment as deployments
from im_bringup.tasks.deployment import Deployment, ParameterValue
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import StateError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient, GuardedNode
from im_core.ros.run import Spinner
from im_msgs.action import Move
from im_msgs.msg import McsState
from im_msgs.srv import ReserveGroup, Snap

PERIODS_S = (0.0045, 0.001)
#: Largest share of missed deadlines in percent, with SCHED_FIFO and without it on an idle computer.
BARS = {0.0045: (0.05, 0.1), 0.001: (0.5, 2.0)}
RUN_S = 20.0
GROUP, CAMERA, PRESET = "testbed", "ceiling_left", "1x18"
TASKS = ("testbed", "mcs", "vss")
_START_S, _ANSWER_S, _POLL_S = 60.0, 60.0, 0.01
_STEP = 0.1
_JOINTS = load_cell().joint_names


class Operator(GuardedNode):
    """Moves the arms to and fro and asks for images, as fast as they come."""

    def __init__(self) -> None:
        super().__init__("deadlines")
        self.state: McsState | None = None
        self.positions: dict[str, float] = {}
        self.images = 0
        self.moves = 0
        self.create_subscription(McsState, "/mcs/state", self._keep, qos.LATCHED)
        self.create_subscription(JointState, "/joint_states", self._hear, qos.EVENTS)
        self._move = GuardedActionClient(self, Move, f"/{GROUP}/move")
        self._snap = self.create_client(Snap, "/vss/snap")

    def _keep(self, message: McsState) -> None:
        self.state = message

    def _hear(self, message: JointState) -> None:
        told = dict(zip(message.name, message.position, strict=True))
        self.positions = {name: told[name] for name in _JOINTS}

    def call(self, kind: type, name: str, request: Any) -> None:
        """Call a service and wait for its answer.

        Raises:
            StateError: It was refused.
            WaitTimeoutError: There is no answer.
        """
        client = self.create_client(kind, name)
        self.wait(client.service_is_ready, name)
        future = client.call_async(request)
        self.wait(future.done, f"an answer of {name}")
        answer = future.result()
        if answer is None or not answer.success:
            raise StateError(f"{name}: {getattr(answer, 'message', 'no answer')}")

    def wait(self, done: Any, what: str) -> None:
        """Wait until ``done()``.

        Raises:
            WaitTimeoutError: It never was.
        """
        deadline = clock.monotonic() + _ANSWER_S
        while not done():
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what=what, seconds=_ANSWER_S)
            clock.sleep(_POLL_S)

    def run(self, seconds: float) -> tuple[McsState, McsState]:
        """Move and look for a while [s]; the states before and after.

        Raises:
            StateError: A motion failed.
        """
        self.wait(lambda: self.state is not None and self.state.state == "motion" and self.positions, "motion")
        self.wait(self._snap.service_is_ready, "/vss/snap")
        before, deadline = self.state, clock.monotonic() + seconds
        home, names = dict(self.positions), sorted(self.positions)
        image = motion = None
        while clock.monotonic() < deadline:
            if image is None or image.done():
                self.images += image is not None
                image = self._snap.call_async(Snap.Request(cameras=[CAMERA]))
            if motion is None or motion.done():
                motion = self._start_move(names, [home[n] + _STEP * (self.moves % 2) for n in names])
                self.moves += 1
            clock.sleep(_POLL_S)
        assert before is not None
        assert self.state is not None
        self.wait(lambda: self.state is not None and self.state.tick > before.tick, "a newer state")
        return before, self.state

    def sway(self) -> None:
        """Move the arms a little and wait until they are there, each time the other way.

        Raises:
            StateError: The motion is refused.
        """
        self.wait(lambda: self.state is not None and self.state.state == "motion" and self.positions, "motion")
        way = _STEP if self.moves % 2 == 0 else -_STEP
        names = sorted(self.positions)
        self.wait(self._start_move(names, [self.positions[n] + way for n in names]).done, "the end of a motion")
        self.moves += 1

    def _start_move(self, names: list[str], positions: list[float]) -> Any:
        """A future that is done when the motion has ended."""
        goal = Move.Goal()
        goal.path.joint_names = names
        goal.path.points = [JointTrajectoryPoint(positions=positions)]
        self.wait(self._move.server_is_ready, f"/{GROUP}/move")
        accepted = self._move.send_goal_async(goal)
        self.wait(accepted.done, "the goal to be accepted")
        handle = accepted.result()
        if handle is None or not handle.accepted:
            raise StateError(f"a motion of {GROUP} was refused")
        return handle.get_result_async()


def deadline_lines(seed: int, port: int) -> list[Line]:
    """Missed deadlines at every period, with the load that was beside.

    Raises:
        ImError: The machine does not start, or refuses to move.
    """
    lines = []
    for period in PERIODS_S:
        with tempfile.TemporaryDirectory(prefix="im_bench_") as folder:
            deployment = smaller(period, seed, port)
            path = Path(folder) / "deployment.yaml"
            path.write_text(deployment.model_dump_json(), encoding="utf-8")  # JSON is YAML
            if start(deployment, path, _START_S) != 0:
                raise StateError("the machine did not start")
            try:
                lines += _measure(period)
            finally:
                rclpy.try_shutdown()
                stop.stop(say=lambda _: None)
    return lines


def smaller(
    period: float, seed: int, port: int, factor: float = 1.0, vss: dict[str, ParameterValue] | None = None
) -> Deployment:
    """Testbed, MCS and cameras of the shipped deployment, all joints in one group.

    Args:
        period: Of the servo [s].
        seed: Of the testbed.
        port: Of the display.
        factor: Of the clock.
        vss: Parameters of the node of the cameras.
    """
    whole = deployments.load(deployments.default_path()).with_values(
        clock_factor=factor, seed=seed, port=port, period=period
    )
    data = json.loads(whole.model_dump_json())
    for host, processes in data["hosts"].items():
        data["hosts"][host] = {name: tasks for name, tasks in processes.items() if name in TASKS}
        data["hosts"][host]["mcs"]["mcs"]["parameters"]["preset"] = PRESET
        data["hosts"][host]["vss"]["vss"]["parameters"].update(vss or {})
    return Deployment.model_validate(data)


def _measure(period: float) -> list[Line]:
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    operator = Operator()
    with Spinner([operator]):
        operator.call(ReserveGroup, "/mcs/reserve", ReserveGroup.Request(group=GROUP))
        operator.call(Trigger, "/mcs/power_on", Trigger.Request())
        operator.call(Trigger, "/mcs/enable_motion", Trigger.Request())
        before, after = operator.run(RUN_S)
    fifo = after.real_time_scheduling
    ticks = after.tick - before.tick
    missed = after.missed_deadlines - before.missed_deadlines
    scheduling = "SCHED_FIFO" if fifo else "no SCHED_FIFO"
    return [
        Line(
            f"{1e3 * period:g} ms, {scheduling}: missed deadlines",
            100.0 * missed / max(1, ticks + missed),
            "%",
            None,
            f"{missed} of {ticks + missed}, {operator.moves} moves and {operator.images} images in {RUN_S:g} s",
            bar=BARS[period][0 if fifo else 1],
        ),
        Line("  mean period", 1e3 * after.mean_period, "ms", 1e3 * period, "nominal"),
    ]
