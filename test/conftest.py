"""Fixtures of the tests with nodes and processes. Every session has a ROS domain and a run folder of its own."""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from im_bringup import leftovers
from im_core import clock

ROOT = Path(__file__).resolve().parent.parent


def pytest_configure(config):
    """Set the environment before any test module imports rclpy."""
    os.environ["ROS_DOMAIN_ID"] = str(100 + os.getpid() % 101)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    folder = Path(tempfile.mkdtemp(prefix="im_test_"))
    for name in ("run", "results", "ros"):
        (folder / name).mkdir()
    os.environ["IM_RUN_DIR"] = str(folder / "run")
    os.environ["IM_RESULTS_DIR"] = str(folder / "results")
    os.environ["ROS_LOG_DIR"] = str(folder / "ros")
    config.stash[FOLDER] = folder


FOLDER = pytest.StashKey()


def pytest_unconfigure(config):
    """Leave nothing behind."""
    leftovers.kill(leftovers.processes(), timeout_s=2.0)
    leftovers.remove_shared_memory()
    shutil.rmtree(config.stash[FOLDER], ignore_errors=True)


@pytest.fixture
def wait_until():
    """``wait_until(condition, what, seconds)``: returns the first true value of the condition, or fails naming what."""

    def wait(condition, what, seconds=15.0):
        deadline = clock.monotonic() + seconds
        while clock.monotonic() < deadline:
            value = condition()
            if value:
                return value
            clock.sleep(0.02)
        pytest.fail(f"waited {seconds:g} s for {what}, in vain")

    return wait


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
    """``process(argv, **environment)``: a process that is ended with the test; its output is in ``.out``."""
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
        child.out.unlink()


@pytest.fixture
def script():
    """``script(name, args...)``: runs ``scripts/<name>.sh`` to its end."""

    def run(name, *arguments, timeout=90.0, **environment):
        return subprocess.run(
            ["bash", str(ROOT / "scripts" / f"{name}.sh"), *map(str, arguments)],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout,
            env={**os.environ, **environment},
            cwd=ROOT,
            check=False,
        )

    return run


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
