"""Fixtures of the tests with nodes and processes.

Every session has a ROS domain of its own, every file a run folder: what one leaves in its stores no other finds.
"""

import contextlib
import fcntl
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from im_bringup.machine import leftovers
from im_bringup.tasks.signed_link import VARIABLE as SECRET_FILE
from im_core import clock, names
from im_core.processes.startup import START_TIMEOUT

ROOT = Path(__file__).resolve().parent.parent


def pytest_configure(config):
    """Set the environment before any test module imports rclpy."""
    config.stash[DOMAIN], domain = own_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "SUBNET"
    os.environ[START_TIMEOUT] = "300"  # a slow or busy computer makes a start late, and fails no test
    folder = Path(tempfile.mkdtemp(prefix="im_test_"))
    for name in ("run", "results", "ros", "cache"):
        (folder / name).mkdir(mode=0o700)
    os.environ["IM_RUN_DIR"] = str(folder / "run")
    os.environ["IM_RESULTS_DIR"] = str(folder / "results")
    if not hasattr(config, "workerinput"):  # processes of one session share what was proved of nets
        os.environ["IM_CACHE_DIR"] = str(folder / "cache")
    os.environ["ROS_LOG_DIR"] = str(folder / "ros")
    secret = folder / "secret"
    secret.touch(mode=0o600)
    secret.write_text("of the hosts of machines that are tested")
    os.environ[SECRET_FILE] = str(secret)
    config.stash[FOLDER] = folder


FOLDER, DOMAIN = pytest.StashKey(), pytest.StashKey()


def own_domain():
    """The lock of a ROS domain that no other session on this host tests in, and its number; its ports are free."""
    for domain in range(100, 39, -1):
        path = Path(tempfile.gettempdir()) / f"im_test_domain_{domain}.lock"
        with contextlib.suppress(OSError):  # another session, or another user, has it
            lock = os.fdopen(os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600), "w")
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                lock.close()
            else:
                return lock, domain
    raise pytest.UsageError("60 sessions test on this host; each needs a ROS domain of its own")


@pytest.fixture
def other_domain():
    """A ROS domain beside the session's own."""
    lock, domain = own_domain()
    with lock:
        yield domain


def own_participants():
    """Ports, counted from the first of the domain, at which participants of this process listen."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])  # as RTPS says
    sockets = set()
    for descriptor in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            sockets.add(descriptor.readlink().name)
    lines = (line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:])
    ports = [int(local.split(":")[1], 16) - first for _, local, *rest in lines if f"socket:[{rest[7]}]" in sockets]
    return sorted(port for port in ports if 0 <= port < 250)


LONGEST = (
    "case_study", "mission", "pick_and_place", "tutorials", "moved_camera", "cells", "case_study_deaths", "hosts",
    "failing_disk", "wall_clock", "chaos", "calibrate_board", "vendor_hour", "pose_cost", "vendor_robot",
    "page_browser", "client", "vss_contention", "trajectory", "scripts", "pnt_journal", "bootstrap_node",
    "your_robot", "peer_commands", "motion", "record_replay", "owners", "bad_bags", "peers", "bodies", "recalibrate",
    "testbed_drivers_node", "calibrate_live", "estop", "start_imports", "wrong_values", "set_up", "middleware_memory",
    "pnt_node", "vss_laser", "imports", "vss_calibration_given", "vss_wrong_input", "vss_known_lengths", "backlog",
    "vss_tutorial", "urgent", "stops_first", "dom_kills",
)  # fmt: skip
"""Files ``test_<name>.py`` that take a third of a minute and more on a busy computer, the longest first."""


def pytest_collection_modifyitems(items):
    """The longest files come first: where files are divided between processes, the others fill in.

    The case study is the first, in a process that has not yet had nodes of others.
    """
    rank = {f"test_{name}.py": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))


def pytest_unconfigure(config):
    """Leave nothing behind."""
    leftovers.end_all()
    leftovers.remove_shared_memory()
    shutil.rmtree(config.stash[FOLDER], ignore_errors=True)


@pytest.fixture(scope="module", autouse=True)
def _run_folder(request):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_RUN_DIR", str(request.config.stash[FOLDER] / "run" / request.path.stem))
        yield


@pytest.fixture(scope="module", autouse=True)
def _one_failure_is_one():
    """A fixture that fails before it could shut ROS down does not take the next files with it.

    Nor do nodes that are still in the graph: services of which a client hears only a part count as none.
    """
    yield
    if "rclpy" in sys.modules:
        sys.modules["rclpy"].try_shutdown()
        assert not own_participants(), "nodes are left in the graph: spin them in a thread that is stopped"


@pytest.fixture(autouse=True)
def _nothing_raised(request, monkeypatch):
    """A node goes on when a callback raises, but whoever wrote that callback did not mean to.

    Errors of ours say what is wrong with what came; any other fails the test, unless it is marked ``raises``.
    """
    from im_core.errors import ImError
    from im_core.ros.failures import Failures

    unexpected, add = [], Failures.add

    def noted(self, what, error, told=str):
        add(self, what, error, told)
        if not isinstance(error, ImError):
            unexpected.append(f"{what}: {error!r}")

    monkeypatch.setattr(Failures, "add", noted)
    yield
    if not request.node.get_closest_marker("raises"):
        assert not unexpected


@pytest.fixture
def ros():
    """ROS initialised; ``ros(node, ...)`` spins nodes in a thread until the test ends."""
    import rclpy

    from im_core.ros.run import spin_in_thread

    rclpy.init(args=[])
    spinners = []

    def spin(*nodes):
        spinners.append(spin_in_thread(*nodes))
        return nodes[0]

    yield spin
    for spinner in reversed(spinners):
        spinner.stop()
    rclpy.try_shutdown()


@pytest.fixture
def process():
    """``process(argv, **environment)``: a process that is ended with the test; its output is in ``.out``.

    Of a test that fails the report has the last of it, as output of the teardown.
    """
    started = []

    def start(*argv, **environment):
        with tempfile.NamedTemporaryFile(prefix="im_test_", suffix=".log", delete=False) as log:
            child = subprocess.Popen(
                [str(part) for part in argv],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env={**os.environ, **environment},
                start_new_session=True,
                cwd=ROOT,
            )
        child.out = Path(log.name)
        started.append(child)
        return child

    yield start
    for child in started:
        if child.poll() is None:
            child.kill()
        child.wait()
        print(f"-- {' '.join(map(str, child.args))[:200]}:\n{child.out.read_text(errors='replace')[-4000:]}")
        child.out.unlink()


@pytest.fixture
def script():
    """``script(name, args...)``: runs ``scripts/<name>.sh`` to its end."""
    from support.whole_machine import run_script

    return run_script


@pytest.fixture
def small_deployment(tmp_path):
    """A deployment of two light tasks: the Data Object Manager and the gripper coordinator."""
    path = tmp_path / "small.yaml"
    path.write_text(
        """\
hosts:
  localhost:
    dom:
      dom: {package: im_dom, executable: dom, node: /dom}
    gripper_coordinator:
      gripper_coordinator: {package: im_coordinators, executable: gripper_coordinator, node: /gripper_coordinator}
""",
        encoding="utf-8",
    )
    return path


@pytest.fixture
def python():
    """The interpreter that runs the tests."""
    return sys.executable


class VisionMachine:
    """Testbed, vision services and a client of theirs, in this process; the camera process beside it."""

    def __init__(self, folder, *parameters):
        import rclpy

        from im_core.ros.run import spin_in_thread
        from im_sim.ros.node import TestbedNode
        from im_vss.ros.node import VssNode

        self.folder = folder
        parameters = ("standalone:=true", "factor:=0.0", "seed:=4", "vss:use_sim_time:=true", *parameters)
        kinds = ("-r" if ":__node:=" in each else "-p" for each in parameters)
        rclpy.init(args=["--ros-args", *(part for pair in zip(kinds, parameters, strict=True) for part in pair)])
        self.testbed, self.client = TestbedNode(), rclpy.create_node("client")
        self.clients = {}
        self.spinners = [spin_in_thread(self.testbed, self.client)]
        self.until(lambda: self.testbed.ready or self.testbed.failed)  # the vision node waits for it without spinning
        self.vss = VssNode()
        self.spinners.append(spin_in_thread(self.vss))
        self.until(lambda: self.vss.ready or self.vss.failed)
        assert self.vss.ready, self.vss.failed or self.testbed.failed

    def until(self, condition, seconds=60.0):
        deadline = clock.monotonic() + seconds
        while not condition():
            assert clock.monotonic() < deadline, "waited in vain"
            clock.sleep(0.01)

    def call(self, kind, service, **fields):
        from im_core.ros.calls import call_blocking

        if service not in self.clients:
            self.clients[service] = self.client.create_client(kind, service)
        return call_blocking(self.clients[service], kind.Request(**fields), 60.0, service)

    def light(self, on):
        from im_msgs.srv import SetLight

        assert self.call(SetLight, "/testbed/set_light", name="left_led", on=on).success

    def light_at_home(self):
        """True place of the left light at the home position [m]: by Denavit-Hartenberg rows and errors of joints."""
        import numpy as np

        from im_cell.robot import kinematic_derivatives, load_cell
        from im_cell.robot.truth import errors_of, load_truth
        from support.puma import wrist_pose

        cell, truth = load_cell(), load_truth(self.folder / "truth.json")
        arm, offset = cell.groups["left"], np.array(truth.leds["left_led"].offset_m)
        pose, home = wrist_pose("left", arm.home), dict(zip(cell.joints_of("left"), arm.home, strict=True))
        level = {name: joint.model_copy(update={"gear_rad": (0.0,) * 4}) for name, joint in truth.joints.items()}
        moved = kinematic_derivatives(cell, arm.tip, home, offset) @ errors_of(cell, arm.tip, level)
        return pose[:3, :3] @ offset + pose[:3, 3] + moved

    def true_camera(self, name):
        """A camera as the testbed has it."""
        from im_cell.camera_model import CameraModel

        true = json.loads((self.folder / "truth.json").read_text())["cameras"][name]
        return CameraModel(640, 480, true["K"], true["D"], true["R_cam_base"], true["t_cam_base_m"])

    def calibrate_cameras(self, *names):
        """Set intrinsics, lenses and poses of cameras as they truly are."""
        from sensor_msgs.srv import SetCameraInfo

        from im_vss.ros.messages import to_camera_info

        for name in names:
            model = self.true_camera(name)
            message = to_camera_info(self.vss._book[name], 0)
            message.k, message.d = model.K.ravel(), model.D
            assert self.call(SetCameraInfo, f"/{name}/set_camera_info", camera_info=message).success
            self.vss._book.set_cameras({name: model}, intrinsics=False)

    def listen(self, kind, topic, profile):
        """A list that grows with the messages of a topic, from now on: both ends know each other."""
        from rclpy.qos import QoSCompatibility, qos_check_compatible

        ours = [
            each
            for node in (self.testbed, self.vss)
            for each in node.publishers
            if each.topic_name == topic and qos_check_compatible(each.qos_profile, profile)[0] != QoSCompatibility.ERROR
        ]
        before, received = [each.get_subscription_count() for each in ours], []
        heard = self.client.create_subscription(kind, topic, received.append, profile)
        self.until(lambda: heard.get_publisher_count() >= max(1, len(ours)))
        self.until(lambda: all(each.get_subscription_count() > n for each, n in zip(ours, before, strict=True)))
        return received


@pytest.fixture(scope="session")
def calibration_request():
    """``calibration_request(problem)``: fields of a request for the ceiling cameras with a problem of the solver's."""
    import numpy as np

    from im_cell.robot import load_cell
    from im_cell.rotations import quaternion_of_matrix
    from im_msgs.msg import KnownLength, Observation, Spot

    cameras, offset = ("ceiling_left", "ceiling_right"), np.array(load_cell().led.offset)

    def spots(uv, covariances):
        return [
            Spot(camera=name, found=bool(np.isfinite(u)), u=u, v=v, covariance=covariance.ravel())
            for name, (u, v), covariance in zip(cameras, uv, covariances, strict=True)
        ]

    def observation(problem, i):
        covariance = problem.position_covariances[i].ravel()
        message = Observation(pose=f"p{i}", position_covariance=covariance)
        place, q = message.wrist.position, message.wrist.orientation
        place.x, place.y, place.z = problem.positions[i] - problem.wrist_rotations[i] @ offset
        q.x, q.y, q.z, q.w = quaternion_of_matrix(problem.wrist_rotations[i])
        message.spots = spots(problem.spots[:, i], problem.spot_covariances[:, i])
        return message

    def length(known, i):
        ends = [spots(known.spots[:, i, end], known.spot_covariances[:, i, end]) for end in range(2)]
        sd = known.standard_deviations[i]
        return KnownLength(length=known.lengths[i], sd=sd, first=ends[0], second=ends[1])

    def fields(problem):
        known = problem.lengths
        return {
            "cameras": list(cameras),
            "observations": [observation(problem, i) for i in range(len(problem.positions))],
            "known_lengths": [length(known, i) for i in range(len(known.lengths))] if known else [],
        }

    return fields


@pytest.fixture(scope="module")
def vss_parameters():
    """Further parameters of the :class:`VisionMachine`, and names of its nodes; for modules to override."""
    return ()


@pytest.fixture(scope="module")
def machine(tmp_path_factory, vss_parameters):
    """The :class:`VisionMachine` of a test module."""
    import rclpy

    folder = tmp_path_factory.mktemp("vss")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("IM_RUN_DIR", str(folder))
        made = VisionMachine(folder, *vss_parameters)
        yield made
        for spinner in reversed(made.spinners):
            spinner.stop()
        rclpy.try_shutdown()
    assert not [name for name in os.listdir("/dev/shm") if f"{names.instance()}_vss" in name]
