"""A vision Service that the catalogue places in another process: by one word, and for its clients nothing changes."""

import contextlib
import sys

import numpy as np
import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import CameraInfo
from visualization_msgs.msg import MarkerArray

from bench.calibration.synthetic import Design, make_scene
from bench.chaos.hosts import connected
from im_bringup.tasks.deployment import default_path
from im_core.config import package_file
from im_core.ros import qos
from im_msgs.msg import VisionState
from im_msgs.srv import Calibrate, TakeCalibration, VisionCancel, VisionQuery
from im_vss import deployment
from im_vss.managers import VisionClient
from support.whole_machine import write_few_poses

CEILING = ["ceiling_left", "ceiling_right"]
START_S, SOLVED_S = 300.0, 300.0


def moved(folder, host="localhost"):
    """A copy of the shipped catalogue in which ``calibrate`` is in the process ``vss_solver``, on a host."""
    catalogue = yaml.safe_load(package_file("im_vss", "config/catalogue.yaml").read_text())
    catalogue["services"]["calibrate"]["process"] = "vss_solver"
    catalogue["processes"]["vss_solver"]["host"] = host
    path = folder / "catalogue.yaml"
    path.write_text(yaml.safe_dump(catalogue, sort_keys=False))
    return path


@pytest.fixture(scope="module")
def vss_parameters(tmp_path_factory):
    return f"catalogue:={moved(tmp_path_factory.mktemp('catalogue'))}", "vss_apart:__node:=vss_solver"


@pytest.fixture(scope="module")
def apart(machine):
    """The node of the process ``vss_solver``, beside testbed and ``/vss``."""
    from im_core.ros.run import spin_in_thread
    from im_vss.ros.apart import ApartNode

    node = ApartNode()
    machine.spinners.append(spin_in_thread(node))
    machine.until(lambda: node.ready or node.failed)
    assert node.ready, node.failed
    machine.until(lambda: "calibrate" in machine.call(VisionQuery, "/vss/query").state.services)
    return node


@pytest.fixture(scope="module")
def seen(calibration_request):
    """What the ceiling cameras see of a light that the robot shows them, as a request."""
    return calibration_request(make_scene(Design(poses=12), 2).problem)


def test_each_process_has_its_services_and_one_tells_of_all(machine, apart):
    state = machine.call(VisionQuery, "/vss/query").state
    assert set(state.services) == {*machine.vss._vsm.services, "calibrate"}
    assert "calibrate" not in machine.vss._vsm.services
    assert [*apart._vsm.services] == ["calibrate"]
    assert [module.name for module in state.modules] == [
        "vm_snap", "vm_image_disp", "vm_spot_disp", "vm_laser", "vm_solver",
    ]  # fmt: skip
    told = machine.listen(DiagnosticArray, "/diagnostics", qos.STATUS)
    wanted = {"vss: calibrations", "vss: modules", "vss_solver: modules"}
    machine.until(lambda: wanted <= {status.name for message in told for status in message.status})


def test_a_request_of_the_other_process_is_seen_and_cancelled_where_all_are(machine, apart, seen):
    latched = machine.listen(VisionState, "/vss/state", qos.LATCHED)
    client = machine.client.create_client(Calibrate, "/vss/calibrate")
    machine.until(client.service_is_ready)
    with apart._vsm.managers["computation"].lend("vm_solver", VisionClient("somebody")):
        future = client.call_async(Calibrate.Request(**seen))
        machine.until(lambda: latched and latched[-1].requests)
        (request,) = latched[-1].requests
        assert request.startswith("calibrate #")
        assert latched[-1].modules[-1].owner == "somebody"
        answer = machine.call(VisionCancel, "/vss/cancel", request=request)
        assert answer.success, answer.status.message
        machine.until(future.done)
    assert request in future.result().status.message
    assert not future.result().success
    answer = machine.call(VisionCancel, "/vss/cancel", request=request)
    assert f"there is no request under way '{request}'" in answer.status.message
    machine.until(lambda: latched[-1].requests == [])


def test_a_calibration_of_the_other_process_is_in_use_where_the_cameras_are(machine, apart, seen):
    info = machine.listen(CameraInfo, "/ceiling_left/camera_info", qos.LATCHED)
    markers = machine.listen(MarkerArray, "/markers", qos.LATCHED_MANY)
    client = machine.client.create_client(Calibrate, "/vss/calibrate")
    machine.until(client.service_is_ready)
    future = client.call_async(Calibrate.Request(**seen, apply=True))
    machine.until(future.done, SOLVED_S)
    answer = future.result()
    assert answer.report.success, answer.status.message or answer.report.message
    ours, theirs = machine.vss._book, apart._book
    machine.until(lambda: info and info[-1].k[0])
    assert np.array_equal(info[-1].k, answer.report.cameras[0].k)
    assert [ours[name].calibrated for name in (*CEILING, "wall")] == [True, True, False]
    machine.until(lambda: all(theirs[name].calibrated for name in CEILING))
    for name in CEILING:
        assert theirs[name].origin == ours[name].origin
        assert np.array_equal(theirs[name].model.K, ours[name].model.K)
        assert np.allclose(theirs[name].model.t_cam_base, ours[name].model.t_cam_base, rtol=0.0, atol=1e-12)
    assert theirs.covariance.cameras == ours.covariance.cameras == tuple(CEILING)
    machine.until(lambda: any(marker.ns == "residuals" for message in markers for marker in message.markers))


def test_a_calibration_set_at_the_cameras_is_known_to_the_other_process(machine, apart):
    machine.calibrate_cameras("wall")
    machine.until(lambda: apart._book["wall"].calibrated)
    assert np.allclose(apart._book["wall"].model.K, machine.true_camera("wall").K)


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("../../wall.yaml", "", "known are"),
        ("laser.yaml", "", "known are"),
        ("wall.yaml", "camera_name: [", "wall.yaml"),
        ("extrinsics.yaml", "transforms: 3", "extrinsics.yaml"),
    ],
)
def test_wrong_files_change_nothing(machine, apart, name, text, sentence):
    before = machine.vss._book.entries()
    request = TakeCalibration.Request()
    request.files.names, request.files.contents = [name], [text]
    answer = machine.call(TakeCalibration, "/vss/take_calibration", files=request.files)
    assert (answer.success, answer.folder) == (False, "")
    assert sentence in answer.status.message
    assert machine.vss._book.entries() == before


@pytest.mark.end_to_end
def test_a_service_goes_to_another_host_by_one_word(tmp_path, capsys):
    """The whole machine calibrates its cameras, and the solver is on another host."""
    catalogue = moved(tmp_path, "far")
    assert deployment.main(["--catalogue", str(catalogue)]) == 0
    placed = yaml.safe_load(capsys.readouterr().out)["hosts"]
    content = yaml.safe_load(default_path().read_text())
    content["hosts"]["localhost"] |= placed["localhost"]
    content["hosts"]["far"] = placed["far"]
    start = (sys.executable, "-m", "im_bringup.machine.start")
    with connected(2) as network, contextlib.ExitStack() as stack:
        here, there = network.hosts
        content["addresses"] = {"localhost": here.address, "far": there.address}
        path = tmp_path / "apart.yaml"
        path.write_text(yaml.safe_dump(content, sort_keys=False))
        agent = there.start(*start, path, "--host", "far")
        done = here.run(*start, path, "--factor", 0, "--timeout", START_S)
        stack.callback(here.run, sys.executable, "-m", "im_bringup.machine.stop")
        assert done.returncode == 0, done.stderr
        tasks = here.run(sys.executable, "-m", "im_bringup.ros.tasks", "--json")
        (solver,) = [task for task in yaml.safe_load(tasks.stdout) if task["name"] == "vss_solver"]
        assert (solver["host"], solver["process"]) == ("far", "vss_solver")
        poses = write_few_poses(tmp_path)
        done = here.run(sys.executable, "-m", "im_bringup.ros.run_command", "calibrate_camera", "--poses_file", poses)
        assert done.returncode == 0, done.stdout + done.stderr
        stack.close()
        assert agent.wait(60.0) == 0
