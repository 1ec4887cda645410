"""What a pose of calibrate_camera costs: the Dispatcher and its Coordinators as processes, beside a DOM that counts."""

import contextlib
import itertools
import json
import math
import re
import statistics
import threading
from functools import partial
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.action import ActionServer
from rclpy.serialization import serialize_message
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from im_cell.robot import load_cell
from im_core import clock
from im_core.config import package_file
from im_core.errors import WaitTimeoutError
from im_core.ros import qos
from im_core.ros.calls import call_blocking, pause
from im_core.ros.guard import GuardedActionClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_dom.ros.node import DomNode
from im_msgs.action import ExecuteCommand, Move
from im_msgs.msg import GroupState, GroupStatus, McsState, Spot
from im_msgs.srv import (
    Calibrate,
    CalibrateCamera,
    CheckPath,
    GetGroupState,
    GroupCommand,
    InverseKinematics,
    ListCommands,
    LoadNet,
    ReserveGroup,
    SetLight,
    SpotFind,
    SpotLook,
)
from support.loop import in_loop
from support.warm import Warm

POSES = 16
LOAD_S = 300.0
"""Patience with the verification of a net among all others: minutes on a slow and busy computer."""
MOST_CALLS = 11
"""Of them two ask in vain whether the arm was reserved for the command: here it is reserved already."""
ARMS = ("left", "right")
CAMERAS = ["ceiling_left", "ceiling_right"]
PROCESSES = {
    "dispatcher": "im_dispatcher.ros.node",
    "motion_coordinator": "im_coordinators.ros.motion",
    "path_planning_coordinator": "im_coordinators.ros.path_planning",
    "vision_coordinator": "im_coordinators.ros.vision",
}
REPORT = {
    "success": True,
    "message": "Two cameras calibrated.",
    "cameras": [],
    "points_used": POSES,
    "points_rejected": [],
    "led_offset_m": [0.0, 0.06, 0.05],
    "chi2_per_dof": 1.1,
    "verdicts": [],
    "scale": None,
    "expected_error": {"triangulation_mm": 0.2, "reprojection_px": None},
}
ALONE = ["--ros-args", "-p", "standalone:=true"]


def _object(name):
    """Name of an object among those of its command."""
    return re.sub(r"^dispatcher/[\d-]+/", "", name)


class CountingDom(DomNode):
    """The real one; keeps what it was asked, and has something done when a pose begins."""

    def __init__(self, journal: Path) -> None:
        self.calls, self.sizes, self.at_pose = [], [], {}
        self._journal = journal
        super().__init__()

    def create_service(self, kind, name, callback, **options):
        notes = {"/dom/put": self.note_put, "/dom/get": self.note_get}
        notes |= {"/dom/list": self.note_list, "/dom/invalidate": self.note_invalidate}

        def noted(request, response):
            notes[name](request)
            return callback(request, response)

        return super().create_service(kind, name, noted if name in notes else callback, **options)

    def note_put(self, request):
        self.calls.append(("put", _object(request.name)))
        if _object(request.name) == "destination":
            self.sizes.append(sum(file.stat().st_size for file in self._journal.rglob("*") if file.is_file()))
            self.at_pose.pop(self.calls.count(("put", "destination")), lambda: None)()

    def note_get(self, request):
        self.calls.append(("look" if request.metadata_only else "get", _object(request.name)))

    def note_list(self, request):
        self.calls.append(("list", request.prefix))

    def note_invalidate(self, request):
        self.calls.append(("invalidate", _object(request.name)))

    def poses(self) -> list[list[tuple[str, str]]]:
        """The calls of each pose, from its destination to the next one."""
        begins = [number for number, call in enumerate(self.calls) if call == ("put", "destination")]
        return [self.calls[begin:end] for begin, end in itertools.pairwise(begins)]


#: Where the right arm stays.
HOME = list(load_cell().groups["right"].home)


class Cell(ManagedNode):
    """MCS, VSS and the light of the testbed, as far as a calibration asks for them; everything succeeds at once."""

    def __init__(self) -> None:
        super().__init__("mcs")
        self.problems, self.moves, self.paths = [], 0, []
        self.hidden, self.late = set(), set()
        self.together, self.under_way = 1, []
        self.lights, self.switched = {"left_led": False, "right_led": True}, []
        self._lights = self.create_publisher(String, "/testbed/lights", qos.LATCHED)
        self.tell_lights()
        self.create_publisher(McsState, "/mcs/state", qos.LATCHED).publish(
            McsState(state="motion", groups=[GroupStatus(group=arm, state="motion", reserved=True) for arm in ARMS])
        )
        for name in ("disable_motion", "power_off"):
            self.create_service(GroupCommand, f"/mcs/group/{name}", self._succeed)
        self.create_service(ReserveGroup, "/mcs/release", self._succeed)
        self.create_service(SetLight, "/testbed/set_light", self._set_light)
        self.create_service(CheckPath, "/mcs/check_path", self._succeed)
        self.create_service(GetGroupState, "/mcs/get_group_state", self._state)
        self.create_service(InverseKinematics, "/mcs/inverse_kinematics", self._configuration)
        self.create_service(SpotLook, "/vss/spot_look", self._look)
        self.create_service(SpotFind, "/vss/spot_find", self._spots)
        self.create_service(Calibrate, "/vss/calibrate", self._calibrate)
        self._move = [ActionServer(self, Move, f"/{arm}/move", partial(self._moved, arm)) for arm in ARMS]

    def tell_lights(self):
        self._lights.publish(String(data=json.dumps(self.lights)))

    def _set_light(self, request, response):
        self.switched.append((request.name, request.on))
        self.lights[request.name] = request.on
        self.tell_lights()
        return self._succeed(request, response)

    def _succeed(self, request, response):
        response.success = True
        return response

    def _state(self, request, response):
        response.success, response.state = True, self._rest(request.group)
        return response

    def _rest(self, group):
        n = 9
        state = GroupState(group=group, at_rest=True, joints=[f"j{number}" for number in range(n)])
        state.q = state.q_rest = [0.1 * self.moves] * n if group == "left" else HOME
        state.q_rest_covariance = [1e-8 if row == column else 0.0 for row in range(n) for column in range(n)]
        state.jacobian = [0.5] * (6 * n)
        state.wrist.position.x, state.wrist.orientation.w = 0.1 * self.moves, 1.0
        state.rest_since.sec = self.moves
        return state

    def _configuration(self, request, response):
        response.success, response.q = True, [request.wrist.position.x] * 9
        return response

    async def _moved(self, arm, goal):
        """An arm arrives when as many as shall move together are under way."""
        self.moves += 1
        self.under_way.append(arm)
        while len(self.under_way) < self.together:
            await pause(self, 0.02)
        self.paths.append((arm, [list(point.positions) for point in goal.request.path.points]))
        goal.succeed()
        return Move.Result(success=True, state=self._rest(arm))

    def _look(self, request, response):
        response.success, response.look = True, str(self.moves)
        return response

    def _spots(self, request, response):
        """What was seen at the look, wherever the arm is meanwhile."""
        response.success, seen = True, int(request.look)
        for camera in request.cameras:
            spot = Spot(camera=camera, found=seen not in self.hidden, cause="blocked", u=float(seen))
            spot.stamp.sec = seen - (seen in self.late)
            response.spots.append(spot)
        return response

    def _calibrate(self, request, response):
        self.problems.append(request)
        response.success = response.report.success = True
        response.report.json = json.dumps(REPORT)
        return response


class Cast:
    """All of them, and a client."""

    def __init__(self, folder: Path, warm: Warm) -> None:
        self.folder, self._warm = folder, warm
        self.dom, self.cell = CountingDom(folder / "dispatcher"), Cell()
        self.testbed, self.client = ManagedNode("testbed"), ManagedNode("client")
        # Here: what is asked, or answered, before client and server know each other is lost.
        self.calibration = self.client.create_client(CalibrateCamera, "/dispatcher/calibrate_camera")
        self.processes = {name: self.start(name) for name in PROCESSES}
        own = yaml.safe_load(package_file("im_cell", "cells/puma_pair/ceiling_40.yaml").read_text())
        own |= {"poses": own["poses"][:POSES], "order": "given"}
        self.file = folder / "poses.yaml"
        self.file.write_text(yaml.safe_dump(own))
        self.names = [pose["name"] for pose in own["poses"]]

    def start(self, name):
        log = self.folder / f"{name}.log"
        return self._warm.start(PROCESSES[name], *ALONE, "-p", f"journal_dir:={self.folder}", log=log)

    def be_known(self):
        """Waits until the dispatcher has discovered the client: what asks last is discovered last, and is answered."""
        asking = self.client.create_client(ListCommands, "/dispatcher/list_commands")
        for _ in range(20):
            with contextlib.suppress(WaitTimeoutError):
                return call_blocking(asking, ListCommands.Request(), 3.0, "the dispatcher to know the client")
        return pytest.fail("the dispatcher does not answer")

    def objects(self):
        return [record.name for record in in_loop(self.dom, self.dom.store.records)]

    def restart(self, name):
        self.processes[name].kill()
        self.processes[name].wait()
        self.processes[name] = self.start(name)

    def end(self):
        """Ends the processes; of a test that fails the report has the last of what they said."""
        for name, process in self.processes.items():
            process.kill()
            process.wait()
            print(f"-- {name}:\n{(self.folder / f'{name}.log').read_text(errors='replace')[-4000:]}")

    def calibrate(self, seconds=60.0):
        request = CalibrateCamera.Request(poses_file=str(self.file))
        return call_blocking(self.calibration, request, seconds, "a calibration")


@pytest.fixture(scope="module")
def warm():
    with Warm(*PROCESSES.values()) as warm:
        yield warm


@pytest.fixture
def cast(tmp_path, warm, monkeypatch, wait_until):
    for name in ("run", "results"):
        (tmp_path / name).mkdir()
        monkeypatch.setenv(f"IM_{name.upper()}_DIR", str(tmp_path / name))
    rclpy.init(args=ALONE)
    cast = Cast(tmp_path, warm)
    try:
        with spin_in_thread(cast.dom, cast.cell, cast.testbed, cast.client):
            wait_until(lambda: cast.dom.ready, "the Data Object Manager")
            for name in PROCESSES:
                wait_until(lambda: cast.client.count_subscribers(f"/{name}/tokens"), f"{name} to listen")  # noqa: B023
            cast.be_known()
            yield cast
        rclpy.try_shutdown()
    finally:
        cast.end()


FOLLOW = """
net: follow
description: Moves along a path that the command names.
commands:
  follow: {needs: [left_arm], arguments: {path: {type: string}}}
places: {idle: {tokens: 1, resource: true}, moved: , bad: }
transitions:
  follow:
    symbol: follow
    in: idle
    out: moved
    request: {to: motion_coordinator.move_robot, arguments: {group: left, path: "${arguments.path}"}}
    on_failure: bad
  followed: {in: moved, out: idle, emit: follow_done}
  not_followed: {in: bad, out: idle, emit: follow_failed}
"""


BOTH = """
net: both
description: Moves both arms at once.
commands:
  both: {needs: [left_arm, right_arm]}
templates:
  arm:
    parameters: [side]
    places: {$(side): , $(side)_moved: , $(side)_failed: }
    transitions:
      $(side):
        in: $(side)
        out: $(side)_moved
        request: {to: motion_coordinator.move_robot, arguments: {group: $(side), path: /corridor_$(side)}}
        on_failure: $(side)_failed
places: {idle: {tokens: 1, resource: true}}
use: {template: arm, for: {side: [left, right]}}
transitions:
  begin: {symbol: both, in: idle, out: [left, right]}
  done: {in: [left_moved, right_moved], out: idle, emit: both_done}
  neither: {in: [left_failed, right_failed], out: idle, emit: both_failed}
  left_only: {in: [left_moved, right_failed], out: idle, emit: both_failed}
  right_only: {in: [left_failed, right_moved], out: idle, emit: both_failed}
"""


def path_of(joints, points):
    points = [JointTrajectoryPoint(positions=point) for point in points]
    return serialize_message(JointTrajectory(joint_names=joints, points=points))


def execute(cast, symbol, **arguments):
    """How a command ended."""
    client = GuardedActionClient(cast.client, ExecuteCommand, "/dispatcher/execute")
    assert client.wait_for_server(60.0)
    goal = ExecuteCommand.Goal(symbol=symbol, arguments=json.dumps(arguments))
    handle = completed(client.send_goal_async(goal))
    return completed(handle.get_result_async()).result


def completed(future):
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(60.0)
    return future.result()


def test_a_path_is_given_by_whoever_asks_and_nothing_that_lies_about_steers_a_command(cast):
    """Whoever had put ``given_path`` or ``path`` into the DOM used to move the arm of somebody else's calibration."""
    joints, stray, given = [f"j{number}" for number in range(9)], [[9.0] * 9], [[0.1] * 9, [0.2] * 9]
    for name, points in (("given_path", stray), ("path", stray), ("destination", stray), ("corridor", given)):
        in_loop(
            cast.dom,
            cast.dom.store.put,
            name,
            "trajectory_msgs/msg/JointTrajectory",
            path_of(joints, points),
            "",
            "a stranger",
            0,
        )
    assert cast.calibrate().success
    assert len(cast.cell.paths) == POSES
    assert all(points != stray for _, points in cast.cell.paths)
    loading = cast.client.create_client(LoadNet, "/dispatcher/load_net")
    guessing = LoadNet.Request(net_yaml=FOLLOW.replace("group: left, ", ""))
    refused = call_blocking(loading, guessing, LOAD_S, "a net to be refused")
    assert "argument group is missing, one of 'left', 'right' (which arm)" in refused.message
    loaded = call_blocking(loading, LoadNet.Request(net_yaml=FOLLOW), LOAD_S, "a net to be loaded")
    assert loaded.success, loaded.message
    result = execute(cast, "follow", path="/corridor")
    assert result.success, result.status.message
    assert cast.cell.paths[-1] == ("left", given)
    for arguments, sentence in (
        ({"path": "corridor"}, r"there is no data object 'dispatcher/[\d-]+/corridor'"),
        ({"path": ""}, "move_robot needs one of the arguments destination, position, joints, posture, path; "),
    ):
        assert re.search(sentence, execute(cast, "follow", **arguments).status.message)
    assert len(cast.cell.paths) == POSES + 1
    both_arms_move_at_once(cast, loading, joints)


def both_arms_move_at_once(cast, loading, joints):
    """The Coordinator serves a request for each; the paths of the one command are two."""
    ways = {arm: [[0.01 * number] * 9] for number, arm in enumerate(ARMS, 1)}
    for arm, points in ways.items():
        kind = "trajectory_msgs/msg/JointTrajectory"
        in_loop(cast.dom, cast.dom.store.put, f"corridor_{arm}", kind, path_of(joints, points), "", "test", 0)
    loaded = call_blocking(loading, LoadNet.Request(net_yaml=BOTH), LOAD_S, "a net to be loaded")
    assert loaded.success, loaded.message
    cast.cell.paths, cast.cell.under_way, cast.cell.together = [], [], 2
    result = execute(cast, "both")
    assert result.success, result.status.message
    assert dict(cast.cell.paths) == ways


def report(answer):
    return json.loads((Path(answer.report.directory) / "report.json").read_text())


def test_a_pose_costs_at_most_eleven_calls_whichever_it_is(cast, wait_until):
    answer = cast.calibrate()
    assert answer.success, answer.message
    wait_until(lambda: cast.objects() == ["calibration", "observations"], "the objects of the command to be forgotten")
    assert cast.cell.switched == [("left_led", True), ("left_led", False)]
    poses = cast.dom.poses()
    assert len(poses) == POSES - 1
    costs = [len(pose) for pose in poses[1:]]  # with the first there is none before it to be kept
    assert max(costs) <= MOST_CALLS
    assert max(costs) - min(costs) <= 1, costs  # whether an object is valid is asked, or was heard in time
    (problem,) = cast.cell.problems
    assert [observation.pose for observation in problem.observations] == cast.names
    assert [observation.spots[0].u for observation in problem.observations] == list(range(1, POSES + 1))
    assert report(answer)["poses"] == POSES
    told = answer.report
    assert json.loads(told.json) == report(answer)
    assert (told.success, answer.message, told.points_used) == (True, REPORT["message"], POSES)
    assert (list(told.led_offset), told.chi2_per_dof, told.lengths_used) == (REPORT["led_offset_m"], 1.1, 0)
    assert math.isnan(told.expected_reprojection)
    growth = [after - before for before, after in itertools.pairwise(cast.dom.sizes)]
    third = POSES // 3
    assert statistics.mean(growth[-third:]) < 1.1 * statistics.mean(growth[1 : 1 + third]), growth


def test_poses_that_cannot_be_used_are_left_out_with_their_reasons(cast):
    cast.cell.hidden, cast.cell.late = {3}, {5}
    answer = cast.calibrate()
    assert answer.success, answer.message
    seen = [name for number, name in enumerate(cast.names, 1) if number not in (3, 5)]
    assert [observation.pose for observation in cast.cell.problems[0].observations] == seen
    reasons = {entry["pose"]: entry["reason"] for entry in report(answer)["points_rejected"]}
    assert set(reasons) == {cast.names[2], cast.names[4]}
    assert "no camera sees the light" in reasons[cast.names[2]]
    assert "before the arm came to rest" in reasons[cast.names[4]]


def test_a_light_that_was_on_is_on_after_a_calibration_that_failed(cast):
    cast.cell.lights["left_led"] = True
    cast.cell.tell_lights()
    cast.cell.hidden = set(range(100))
    answer = cast.calibrate()
    assert not answer.success
    assert "no camera sees the light" in answer.message
    assert cast.cell.lights == {"left_led": True, "right_led": True}
    assert len(cast.cell.switched) == 2


@pytest.mark.parametrize("victim", ["dispatcher", "vision_coordinator"])
def test_what_was_observed_outlives_whoever_keeps_it(cast, victim, wait_until):
    """The client of a dispatcher that dies gets no answer; the report is written all the same."""
    cast.cell.hidden, cast.cell.lights["left_led"] = {3}, True
    cast.cell.tell_lights()
    cast.dom.at_pose[6] = lambda: cast.restart(victim)
    service = cast.client.create_client(CalibrateCamera, "/dispatcher/calibrate_camera")
    wait_until(service.service_is_ready, "the dispatcher")
    clock.sleep(1.0)
    answer = service.call_async(CalibrateCamera.Request(poses_file=str(cast.file)))
    wait_until(lambda: cast.cell.problems or answer.done(), "the calibration", 60.0)
    assert cast.cell.problems, answer.result().message
    written = cast.folder / "results" / "latest" / "report.json"
    wait_until(written.exists, "the report")
    wait_until(lambda: len(cast.cell.switched) > 1, "the light")
    wait_until(lambda: cast.objects() == ["calibration", "observations"], "the objects of the command to be forgotten")
    assert cast.cell.lights == {"left_led": True, "right_led": True}
    found = json.loads(written.read_text())
    seen = [name for number, name in enumerate(cast.names, 1) if number != 3]
    assert [observation.pose for observation in cast.cell.problems[-1].observations] == seen
    assert found["poses"] == POSES
    assert [entry["pose"] for entry in found["points_rejected"]] == [cast.names[2]]
