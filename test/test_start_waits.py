"""``start --timeout`` reaches every wait of a part of the machine for another one."""

from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from std_msgs.msg import Float64, String, UInt8

from im_bringup.machine import start
from im_bringup.ros import agent
from im_bringup.tasks.deployment import options_text
from im_cell.robot import load_cell
from im_core.errors import LinkError, WaitTimeoutError
from im_core.ros import qos
from im_core.startup import (
    OPTIONS_TOPIC,
    PHASE_TOPIC,
    START_TIMEOUT,
    TIMEOUT_TOPIC,
    UNPROVED,
    StartupPhase,
    patience_s,
)
from im_mcs.limits.configuration import load_config
from im_mcs.testbed import TestbedInterface
from im_sim.cameras import process as cameras
from im_sim.cameras.protocol import CameraSettings
from im_vss.settings import load_settings

INSTANCE = "im_nobody"


@pytest.fixture(autouse=True)
def short(monkeypatch, tmp_path):
    monkeypatch.setenv(START_TIMEOUT, "0.25")
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))


def test_the_parts_wait_for_less_than_the_whole(monkeypatch):
    assert patience_s() == pytest.approx(0.2)
    monkeypatch.delenv(START_TIMEOUT)
    assert patience_s() == pytest.approx(48.0)


@pytest.mark.parametrize("text", ["0", "-3", "nan", "inf", "soon"])
def test_a_timeout_that_is_none_is_refused(text, capsys):
    with pytest.raises(SystemExit):
        start.parser().parse_args(["--timeout", text])
    assert f"{text} is no time between 0 and 86400 s" in capsys.readouterr().err


def test_the_bootstrap_is_told_and_so_are_all_it_starts(monkeypatch, tmp_path):
    told = {}
    monkeypatch.setattr(start, "ChildProcess", lambda argv, **options: told.update(options["environment"]))
    monkeypatch.setattr(start, "path_of", lambda package, name: Path(name))
    deployment = start.deployments.load(start.deployments.default_path())
    start.spawn_bootstrap(deployment, tmp_path, 240.0)
    assert told[START_TIMEOUT] == "240.0"


def test_the_drivers_of_the_servo():
    config = load_config()
    with pytest.raises(LinkError, match=r"waited 0\.2 s"):
        TestbedInterface.load(config.testbed, config.slots, INSTANCE)


def test_the_cameras_for_their_host_and_for_the_truth(tmp_path):
    cell = load_cell()
    settings = CameraSettings(cameras=("wall",), sensor=load_settings(cell).sensor, nominal_exposure=0.01)
    with pytest.raises(LinkError, match=r"waited 0\.2 s"):
        cameras.CameraProcess(INSTANCE, None, cell, settings)
    with pytest.raises(WaitTimeoutError, match=r"waited 0\.2 s for the testbed to write truth"):
        cameras._await_truth(tmp_path / "truth.json", 1)


def test_the_agent_of_another_host_waits_for_the_time_and_tells_it_to_all_it_starts(
    ros, monkeypatch, small_deployment, wait_until
):
    text = small_deployment.read_text().replace("    gripper_coordinator:\n", "  far:\n    gripper_coordinator:\n", 1)
    small_deployment.write_text(text)
    started = []

    def note_start(self):
        started.append((self.environment[START_TIMEOUT], self.environment[UNPROVED]))
        return []

    monkeypatch.setattr(agent.Agent, "start", note_start)
    node = agent.AgentNode(start.deployments.load(small_deployment), "far")
    monkeypatch.setattr(rclpy, "try_shutdown", lambda: None)  # the agent's own end; the test's comes with its fixture
    bootstrap = Node("bootstrap")
    ros(node, bootstrap)
    phases = bootstrap.create_publisher(UInt8, PHASE_TOPIC, qos.LATCHED)
    times = bootstrap.create_publisher(Float64, TIMEOUT_TOPIC, qos.LATCHED)
    options = bootstrap.create_publisher(String, OPTIONS_TOPIC, qos.LATCHED)
    phases.publish(UInt8(data=int(StartupPhase.LOAD)))
    times.publish(Float64(data=float("nan")))
    wait_until(lambda: node.failures.counts, "the complaint about a time that is none")
    options.publish(String(data='{"factor": 0.0}'))
    wait_until(lambda: sum(node.failures.counts.values()) > 1, "the complaint about options that are none")
    times.publish(Float64(data=240.0))
    told = start.deployments.load(small_deployment).with_values(0.0, 7, None, unproved=True)
    assert not started
    options.publish(String(data=options_text(told)))
    wait_until(lambda: started, "the start of the tasks")
    phases.publish(UInt8(data=int(StartupPhase.SHUTDOWN)))
    wait_until(lambda: node.finished, "the end of the agent")
    node.shut_down()
    assert started == [("240.0", "1")]
