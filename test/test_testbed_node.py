"""Node ``/testbed`` as ROS users meet it."""

import json
import os
import signal

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

from im_cell.link import CameraEnd, HostEnd, PanelEnd, ServoEnd
from im_core import clock, names
from im_core.config import package_file
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.run import spin_in_thread
from im_msgs.msg import TaskStatus
from im_msgs.srv import Advance, GetTruth, InjectFault, PlaceObject, PutInJaws, SetLight
from im_sim.ros.node import TestbedNode


def start(parameters):
    """Initialise ROS with parameters of /testbed, and make the node."""
    arguments = ["--ros-args"]
    for name, value in {"standalone": "true", **parameters}.items():
        arguments += ["-p", f"{name}:={value}"]
    rclpy.init(args=arguments)
    return TestbedNode()


def until(condition, seconds=60.0):
    deadline = clock.monotonic() + seconds
    while not condition():
        assert clock.monotonic() < deadline, "waited in vain"
        clock.sleep(0.01)


@pytest.fixture
def run_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    yield tmp_path
    rclpy.try_shutdown()


def test_a_session(run_folder):
    node = start({"factor": 0.0, "seed": 4})
    listener = rclpy.create_node("listener")
    clocks, lights, diagnostics = [], [], []
    listener.create_subscription(Clock, "/clock", lambda m: clocks.append(m.clock), 10)
    listener.create_subscription(String, "/testbed/lights", lambda m: lights.append(json.loads(m.data)), qos.LATCHED)
    listener.create_subscription(DiagnosticArray, "/diagnostics", diagnostics.append, 10)
    set_light = listener.create_client(SetLight, "/testbed/set_light")
    get_truth = listener.create_client(GetTruth, "/testbed/get_truth")
    advance = listener.create_client(Advance, "/testbed/advance")
    with spin_in_thread(node, listener):
        until(lambda: node.ready or node.failed)
        assert node.ready, node.failed

        answer = call_blocking(set_light, SetLight.Request(name="left_led", on=True), 60.0, "light")
        assert (answer.success, answer.message) == (True, "left_led is on")
        until(lambda: lights and lights[-1] == {"left_led": True, "right_led": False})
        answer = call_blocking(set_light, SetLight.Request(name="left_lamp", on=True), 60.0, "light")
        assert not answer.success
        assert "there is no light 'left_lamp'; did you mean 'left_led'?" in answer.message

        with CameraEnd.attach(names.instance(), timeout_s=60.0) as camera:
            exposure = camera.expose(2, blank_light=False, timeout_s=60.0)
        assert exposure.light_fraction == {"left_led": 1.0, "right_led": 0.0}

        answer = call_blocking(advance, Advance.Request(duration=0.45), 60.0, "time")
        assert answer.success, answer.message
        assert answer.stamp.nanosec == 102 * 4_500_000
        until(lambda: clocks and clocks[-1] == answer.stamp)
        answer = call_blocking(advance, Advance.Request(duration=-1.0), 60.0, "time")
        assert (answer.success, answer.message) == (False, "duration -1.0 of /testbed is not between 0 and 3600")

        answer = call_blocking(get_truth, GetTruth.Request(), 60.0, "truth")
        truth = json.loads(answer.json)
        assert truth["seed"] == 4
        assert set(truth["cameras"]) == {"ceiling_left", "ceiling_right", "wall", "table", "wrist_left"}
        assert truth == json.loads((run_folder / "truth.json").read_text())
        until(lambda: any(status.message == "running" for array in diagnostics for status in array.status))
    assert not [name for name in os.listdir("/dev/shm") if f"{names.instance()}_testbed" in name]


def test_faults_and_objects_by_service(run_folder):
    node = start({"factor": 0.0})
    listener = rclpy.create_node("listener")
    inject = listener.create_client(InjectFault, "/testbed/inject_fault")
    put = listener.create_client(PutInJaws, "/testbed/put_in_jaws")
    with spin_in_thread(node, listener):
        until(lambda: node.ready or node.failed)
        assert node.ready, node.failed
        ends = [kind.attach(names.instance(), timeout_s=60.0) for kind in (PanelEnd, ServoEnd, HostEnd)]
        panel, servo, _ = ends

        def broken(fault, joint, active):
            request = InjectFault.Request(fault=fault, joint=joint, active=active)
            answer = call_blocking(inject, request, 60.0, "fault")
            panel.wait_tick(panel.request_time(1), timeout_s=60.0)
            return answer.success, answer.message

        assert broken("encoder_nan", "left_j2", True) == (True, "broken: encoder_nan of left_j2")
        assert np.flatnonzero(np.isnan(servo.read_state().q)).tolist() == [4]
        assert broken("encoder_nan", "left_j2", False) == (True, "nothing is broken")
        assert np.isfinite(servo.read_state().q).all()
        success, message = broken("brake_stuck", "left_j9", True)
        assert not success
        assert "there is no joint 'left_j9'; did you mean" in message

        request = PutInJaws.Request(gripper="left_gripper", width=0.05, stiffness=1e4, mass=0.2)
        assert call_blocking(put, request, 60.0, "object").success
        panel.wait_tick(panel.request_time(1), timeout_s=60.0)
        assert panel.objects()[0].mass == 0.2
        answer = call_blocking(put, PutInJaws.Request(gripper="left_gripper", width=-1.0), 60.0, "object")
        assert not answer.success
        assert "width and stiffness are > 0" in answer.message
        for end in ends:
            end.close()


def test_a_dead_physics_process_is_a_failed_task(run_folder):
    node = start({"factor": 1.0})
    statuses = []
    node.create_subscription(TaskStatus, "/im/task_status", statuses.append, qos.STATUS)
    with spin_in_thread(node):
        until(lambda: node.ready or node.failed)
        os.kill(node._child.pid, signal.SIGKILL)
        until(lambda: node.failed)
        assert "im_sim.physics ended with code -9" in node.failed
        until(lambda: any(status.phase == TaskStatus.FAILED for status in statuses))
    assert not [name for name in os.listdir("/dev/shm") if f"{names.instance()}_testbed" in name]


@pytest.mark.parametrize(("parameters", "message"), [
    ({"factor": -1.0}, "factor -1.0 of /testbed is not between 0 and inf"),
    ({"factor": "fast"}, "parameter factor of /testbed is 'fast', not a number"),
])  # fmt: skip
def test_wrong_parameters_are_one_sentence(run_folder, parameters, message):
    node = start(parameters)
    with spin_in_thread(node):
        until(lambda: node.ready or node.failed)
        assert message in node.failed


def test_a_missing_cell_is_one_sentence(run_folder, monkeypatch):
    monkeypatch.setenv("IM_CELL", "nowhere.yaml")
    test_wrong_parameters_are_one_sentence(run_folder, {}, "nowhere.yaml: cannot be read")


def test_services_of_an_unconfigured_testbed_answer(run_folder):
    node = start({"standalone": "false"})
    assert node.get_parameter("standalone").type_ == Parameter.Type.BOOL
    client = node.create_client(SetLight, "/testbed/set_light")
    with spin_in_thread(node):
        answer = call_blocking(client, SetLight.Request(name="left_led", on=True), 60.0, "light")
    assert (answer.success, answer.message) == (False, "the testbed is not configured yet")


def test_free_bodies_are_placed_by_name(run_folder, monkeypatch):
    monkeypatch.setenv("IM_OBJECTS", str(package_file("im_cell", "cells/puma_pair/objects.yaml")))
    node = start({"factor": 0.0})
    listener = rclpy.create_node("listener")
    place = listener.create_client(PlaceObject, "/testbed/place_object")
    get_truth = listener.create_client(GetTruth, "/testbed/get_truth")
    put = listener.create_client(PutInJaws, "/testbed/put_in_jaws")
    with spin_in_thread(node, listener):
        until(lambda: node.ready or node.failed)
        assert node.ready, node.failed
        panel = PanelEnd.attach(names.instance(), timeout_s=60.0)

        def placed(name, x, w=1.0):
            request = PlaceObject.Request(name=name)
            request.pose.position.x, request.pose.position.y, request.pose.position.z = x, 1.2, 0.82
            request.pose.orientation.w = w
            answer = call_blocking(place, request, 60.0, "object")
            panel.wait_tick(panel.request_time(20), timeout_s=60.0)
            return answer.success, answer.message

        assert placed("can", 0.6) == (True, "can is at (0.6, 1.2, 0.82) m")
        truth = json.loads(call_blocking(get_truth, GetTruth.Request(), 60.0, "truth").json)
        assert truth["objects"]["can"][:3] == pytest.approx([0.6, 1.2, 0.82], abs=1e-3)
        for refused, why in (
            (placed("cup", 0.6), "there is no object 'cup'"),
            (placed("can", 9.0), "at most 3.9 m from the origin"),
            (placed("can", 0.6, w=0.5), "the orientation"),
        ):
            assert not refused[0]
            assert why in refused[1]
        held = call_blocking(put, PutInJaws.Request(gripper="left_gripper", width=0.05, stiffness=1e4), 60.0, "object")
        assert not held.success
        assert "this cell has free bodies" in held.message
        panel.close()
    node.destroy_node()
    listener.destroy_node()
