"""What a pose of calibrate_camera costs: the Dispatcher and its Coordinators as processes, beside a DOM that counts."""

import itertools
import json
import os
import signal
import statistics
import sys
from pathlib import Path

import pytest
import rclpy
import yaml
from rclpy.action import ActionServer
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core import clock
from im_core.config import package_file
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_dom.ros.node import DomNode
from im_msgs.action import Move
from im_msgs.msg import GroupState, McsState, Spot
from im_msgs.srv import (
    Calibrate,
    CalibrateCamera,
    CheckPath,
    GetGroupState,
    InverseKinematics,
    ReserveGroup,
    SetLight,
    SpotFind,
)

POSES = 16
MOST_CALLS = 10
CAMERAS = ["ceiling_left", "ceiling_right"]
PROCESSES = {
    "dispatcher": "im_dispatcher.ros.node",
    "motion_coordinator": "im_coordinators.ros.motion",
    "path_planning_coordinator": "im_coordinators.ros.path_planning",
    "vision_coordinator": "im_coordinators.ros.vision",
}
ALONE = ["--ros-args", "-p", "standalone:=true"]


class CountingDom(DomNode):
    """The real one; keeps what it was asked, and has something done when a pose begins."""

    def __init__(self, journal: Path) -> None:
        self.calls, self.sizes, self.at_pose = [], [], {}
        self._journal = journal
        super().__init__()

    def _put(self, request, response):
        self.calls.append(("put", request.name))
        if request.name == "destination":
            self.sizes.append(sum(file.stat().st_size for file in self._journal.rglob("*") if file.is_file()))
            self.at_pose.pop(self.calls.count(("put", "destination")), lambda: None)()
        return super()._put(request, response)

    def _get(self, request, response):
        self.calls.append(("look" if request.metadata_only else "get", request.name))
        return super()._get(request, response)

    def _list(self, request, response):
        self.calls.append(("list", request.prefix))
        return super()._list(request, response)

    def _invalidate(self, request, response):
        self.calls.append(("invalidate", request.name))
        return super()._invalidate(request, response)

    def poses(self) -> list[list[tuple[str, str]]]:
        """The calls of each pose, from its destination to the next one."""
        begins = [number for number, call in enumerate(self.calls) if call == ("put", "destination")]
        return [self.calls[begin:end] for begin, end in itertools.pairwise(begins)]


class Cell(ManagedNode):
    """MCS, VSS and the light, as far as a calibration asks for them; everything succeeds at once."""

    def __init__(self) -> None:
        super().__init__("mcs")
        self.problems, self.moves, self.looks = [], 0, 0
        self.hidden, self.late = set(), set()
        self.lights, self.switched = {"left_led": False, "right_led": True}, []
        self._lights = self.create_publisher(String, "/testbed/lights", qos.LATCHED)
        self.tell_lights()
        self.create_publisher(McsState, "/mcs/state", qos.LATCHED).publish(
            McsState(state="motion", reserved_groups=["left"])
        )
        for name in ("disable_motion", "power_off"):
            self.create_service(Trigger, f"/mcs/{name}", self._succeed)
        self.create_service(ReserveGroup, "/mcs/release", self._succeed)
        self.create_service(SetLight, "/testbed/set_light", self._set_light)
        self.create_service(CheckPath, "/mcs/check_path", self._succeed)
        self.create_service(GetGroupState, "/mcs/get_group_state", self._state)
        self.create_service(InverseKinematics, "/mcs/inverse_kinematics", self._configuration)
        self.create_service(SpotFind, "/vss/spot_find", self._spots)
        self.create_service(Calibrate, "/vss/calibrate", self._calibrate)
        self._move = ActionServer(self, Move, "/left/move", self._moved)

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
        state.q = state.q_rest = [0.1 * self.moves] * n
        state.q_rest_covariance = [1e-8 if row == column else 0.0 for row in range(n) for column in range(n)]
        state.jacobian = [0.5] * (6 * n)
        state.wrist.position.x, state.wrist.orientation.w = 0.1 * self.moves, 1.0
        state.rest_since.sec = self.moves
        return state

    def _configuration(self, request, response):
        response.success, response.q = True, [request.wrist.position.x] * 9
        return response

    def _moved(self, goal):
        self.moves += 1
        goal.succeed()
        return Move.Result(success=True, state=self._rest("left"))

    def _spots(self, request, response):
        self.looks += 1
        response.success = True
        for camera in request.cameras:
            spot = Spot(camera=camera, found=self.moves not in self.hidden, cause="blocked", u=float(self.moves))
            spot.stamp.sec = self.moves - (self.moves in self.late)
            response.spots.append(spot)
        return response

    def _calibrate(self, request, response):
        self.problems.append(request)
        response.success = response.report.success = True
        response.report.json = json.dumps({"success": True, "points_rejected": []})
        return response


class Cast:
    """All of them, and a client."""

    def __init__(self, folder: Path, process) -> None:
        self.folder, self._process = folder, process
        self.dom, self.cell = CountingDom(folder / "dispatcher"), Cell()
        self.client = ManagedNode("client")
        self.processes = {name: self.start(name) for name in PROCESSES}
        own = yaml.safe_load(package_file("im_dispatcher", "poses/ceiling_40.yaml").read_text())
        own["poses"] = own["poses"][:POSES]
        self.file = folder / "poses.yaml"
        self.file.write_text(yaml.safe_dump(own))
        self.names = [pose["name"] for pose in own["poses"]]

    def start(self, name):
        return self._process(sys.executable, "-m", PROCESSES[name], *ALONE, "-p", f"journal_dir:={self.folder}")

    def restart(self, name):
        os.kill(self.processes[name].pid, signal.SIGKILL)
        self.processes[name] = self.start(name)

    def calibrate(self, seconds=60.0):
        service = self.client.create_client(CalibrateCamera, "/dispatcher/calibrate_camera")
        return call_blocking(service, CalibrateCamera.Request(poses_file=str(self.file)), seconds, "a calibration")


@pytest.fixture
def cast(tmp_path, process, monkeypatch):
    for name in ("run", "results"):
        (tmp_path / name).mkdir()
        monkeypatch.setenv(f"IM_{name.upper()}_DIR", str(tmp_path / name))
    rclpy.init(args=ALONE)
    cast = Cast(tmp_path, process)
    with spin_in_thread(cast.dom, cast.cell, cast.client):
        yield cast
    rclpy.try_shutdown()


def report(answer):
    return json.loads((Path(answer.report.directory) / "report.json").read_text())


def test_a_pose_costs_at_most_ten_calls_whichever_it_is(cast):
    answer = cast.calibrate()
    assert answer.success, answer.message
    assert cast.cell.switched == [("left_led", True), ("left_led", False)]
    poses = cast.dom.poses()
    assert len(poses) == POSES - 1
    costs = [len(pose) for pose in poses]
    assert max(costs) <= MOST_CALLS
    assert len(set(costs)) == 1, costs
    (problem,) = cast.cell.problems
    assert [observation.pose for observation in problem.observations] == cast.names
    assert [observation.spots[0].u for observation in problem.observations] == list(range(1, POSES + 1))
    assert report(answer)["poses"] == POSES
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
    wait_until(service.service_is_ready, "the dispatcher", 20.0)
    clock.sleep(1.0)
    service.call_async(CalibrateCamera.Request(poses_file=str(cast.file)))
    wait_until(lambda: cast.cell.problems, "the calibration", 60.0)
    written = cast.folder / "results" / "latest" / "report.json"
    wait_until(written.exists, "the report")
    wait_until(lambda: len(cast.cell.switched) > 1, "the light")
    assert cast.cell.lights == {"left_led": True, "right_led": True}
    found = json.loads(written.read_text())
    seen = [name for number, name in enumerate(cast.names, 1) if number != 3]
    assert [observation.pose for observation in cast.cell.problems[-1].observations] == seen
    assert found["poses"] == POSES
    assert [entry["pose"] for entry in found["points_rejected"]] == [cast.names[2]]
