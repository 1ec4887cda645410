"""``start --timeout`` reaches every wait of a part of the machine for another one."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from std_msgs.msg import String

from im_bringup.machine import start
from im_bringup.ros import agent
from im_bringup.tasks.deployment import options_text
from im_bringup.tasks.signed_link import HostOrder, SignedLink, orders_topic, reports_topic
from im_cell.robot import load_cell
from im_core.errors import LinkError, WaitTimeoutError
from im_core.processes.agent_socket import AgentOrder
from im_core.processes.startup import START_TIMEOUT, UNPROVED, StartupPhase, patience_s
from im_core.ros import qos
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
    start.spawn_bootstrap(deployment, tmp_path, 240.0, resume=False)
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


def test_the_agent_of_another_host_does_what_the_bootstrap_has_signed_and_nothing_else(
    ros, monkeypatch, small_deployment, wait_until
):
    """It waits for the options of the start, and tells them to all it starts; strangers and old orders end nothing."""
    text = small_deployment.read_text().replace("    gripper_coordinator:\n", "  far:\n    gripper_coordinator:\n", 1)
    small_deployment.write_text(text)
    secret, started = b"of both hosts", []

    def note_start(self):
        started.append((self.environment[START_TIMEOUT], self.environment[UNPROVED]))
        return []

    monkeypatch.setattr(agent.Agent, "start", note_start)
    node = agent.AgentNode(start.deployments.load(small_deployment), "far", secret)
    monkeypatch.setattr(rclpy, "try_shutdown", lambda: None)  # the agent's own end; the test's comes with its fixture
    bootstrap, link, asked, sent = Node("bootstrap"), SignedLink(secret, "far"), [], []
    bootstrap.create_subscription(String, reports_topic("far"), lambda message: asked.append(message.data), qos.EVENTS)
    orders = bootstrap.create_publisher(String, orders_topic("far"), qos.EVENTS)
    ros(node, bootstrap)
    wait_until(lambda: asked, "the question of the agent")
    told = start.deployments.load(small_deployment).with_values(clock_factor=0.0, seed=7, unproved=True)

    def order(phase, options, by=link):
        content = json.dumps(asdict(HostOrder(AgentOrder(int(phase), {}), 240.0, options, "run")))
        life = link.open(reports_topic("far"), asked[-1]).sender
        sent.append(by.sign(orders_topic("far"), content, life))
        orders.publish(String(data=sent[-1]))

    def complaints():
        return sum(node.failures.counts.values())

    order(StartupPhase.LOAD, options_text(told), by=SignedLink(b"made up", "far"))
    wait_until(complaints, "the complaint about an order with a wrong signature")
    order(StartupPhase.LOAD, '{"factor": 0.0}')
    wait_until(lambda: complaints() == 2, "the complaint about options that are none")
    assert not started
    order(StartupPhase.LOAD, options_text(told))
    wait_until(lambda: started, "the start of the tasks")
    assert started == [("240.0", "1")]

    order(StartupPhase.SHUTDOWN, "", by=SignedLink(b"made up", "far"))
    wait_until(lambda: complaints() == 3, "the complaint about an end with a wrong signature")
    assert not node.finished
    order(StartupPhase.SHUTDOWN, "")
    wait_until(lambda: node.finished, "the end of the agent")
    node.shut_down()

    node.finished, node._link = False, SignedLink(secret, "far")  # as one of the next run
    for former in sent:
        orders.publish(String(data=former))
    orders.publish(String(data="no more"))
    wait_until(lambda: complaints() == 6, "the complaints about three messages with no signature of ours")
    assert (node.finished, len(started)) == (False, 1)
