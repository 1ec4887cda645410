"""Agents of another host, as the bootstrap hears them: one of several gets orders, and a strange one is named."""

import json
import os
from dataclasses import asdict
from functools import partial

import pytest
from std_msgs.msg import String

from im_bringup.machine import machine_state
from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.machine.nets import MachineNets
from im_bringup.ros import agent as agent_of_host
from im_bringup.ros import agents
from im_bringup.tasks.agent import Agent
from im_bringup.tasks.deployment import Deployment, options_text
from im_bringup.tasks.signed_link import HostOrder, HostReport, SignedLink, orders_topic, reports_topic
from im_core import names
from im_core.config import parse_model
from im_core.errors import DataError
from im_core.processes.agent_socket import AgentOrder
from im_core.processes.startup import StartupPhase
from im_core.ros.guard import GuardedNode
from support.tasks import placed

FAR = """
hosts:
  near: {one: {one: {package: im_dom, executable: dom, node: /one}}}
  far: {dom: {dom: {package: im_dom, executable: dom, node: /dom}}}
"""
SECRET = b"thirty-two characters at the least"


class World:
    """A bootstrap with agents of a host, at a time that the test says."""

    def __init__(self, node, folder, monkeypatch):
        self.now, self._orders, self.digests = 0.0, [], {"cell": "ours"}
        monkeypatch.setattr(agents.clock, "monotonic", lambda: self.now)
        self.bootstrap = Bootstrap(
            placed(host="far"), Agent((), os.environ), "near", MachineNets(folder, unproved=False), self.digests
        )
        self.remote = agents.RemoteAgents(node, self.bootstrap, ["far"], "{}", SECRET)
        monkeypatch.setattr(self.remote._agents[0].publisher, "publish", lambda order: self._orders.append(order.data))

    def report(self, agent, serves=""):
        """Have an agent report, again if it is asked to; return the phase that it is ordered, or None."""
        told = self.hear(agent, serves)
        if told and told[-1] is None:
            return self.report(agent, serves)
        return StartupPhase(told[-1]["phase"]) if told else None

    def hear(self, agent, serves=""):
        """Have an agent report; return the orders that it gets."""
        content = json.dumps(asdict(HostReport([], self.digests, serves)))
        self.remote._hear(self.remote._agents[0], String(data=agent.sign(reports_topic("far"), content)))
        opened = [agent.open(orders_topic("far"), order).content for order in self._orders]
        self._orders.clear()
        return [json.loads(content)["order"] for content in opened if content is not None]


@pytest.fixture
def world(ros, tmp_path, monkeypatch):
    node = GuardedNode("bootstrap")
    yield World(node, tmp_path, monkeypatch)
    node.destroy_node()


def test_of_two_agents_of_a_host_the_first_gets_orders_while_it_is_heard(world):
    first, second = SignedLink(SECRET, "far"), SignedLink(SECRET, "far")
    assert world.report(first) is StartupPhase.LOAD
    for _ in range(10):
        world.now += 0.5
        assert world.report(second) is None
        assert world.report(first) is StartupPhase.LOAD


def test_an_agent_takes_the_place_of_one_that_is_silent_and_that_one_ends_when_it_comes_back(world):
    first, second = SignedLink(SECRET, "far"), SignedLink(SECRET, "far")
    for _ in range(2):
        assert world.report(first) is StartupPhase.LOAD
    world.now += 5.0
    for _ in range(2):
        assert world.report(second) is StartupPhase.LOAD
    assert world.report(first) is StartupPhase.SHUTDOWN
    assert world.report(second) is StartupPhase.LOAD


def test_a_recorded_message_of_a_former_run_ends_no_agent_that_was_silent(world):
    agent, former = SignedLink(SECRET, "far"), SignedLink(SECRET, "far")
    for _ in range(2):
        assert world.report(agent) is StartupPhase.LOAD
    world.now += 5.0
    assert world.hear(former) == [None]  # whoever plays it back cannot answer in its name
    assert world.report(agent) is StartupPhase.LOAD


def test_an_agent_with_another_secret_is_named_by_a_start_that_waits_for_it(world):
    assert world.bootstrap.missing()[0] == "host far: no agent was heard; on it: start.sh FILE --host far"
    with pytest.raises(DataError, match="is not signed with the secret"):
        world.report(SignedLink(b"another secret of thirty characters", "far"))
    told = "a message on /agent_far/reports for host far is not signed with the secret of IM_SECRET_FILE"
    assert world.bootstrap.missing()[0] == f"host far: {told}"


@pytest.mark.parametrize("ready", [False, True])
def test_an_agent_with_another_cell_gets_no_order_at_all(world, ready):
    if ready:
        assert world.report(SignedLink(SECRET, "far")) is StartupPhase.LOAD
        world.now += 5.0
    world.digests = {"cell": "theirs"}
    agent = SignedLink(SECRET, "far")
    for _ in range(3):
        assert world.report(agent) is None
    world.bootstrap.shut_down()
    world.remote.order()
    assert world.report(agent) is None
    assert world.bootstrap.missing() == ["host far differs from host near in: cell; give both the same files"]


def test_a_start_ends_where_the_agent_works_for_a_machine_of_another_host(world, monkeypatch):
    agent = SignedLink(SECRET, "far")
    monkeypatch.setenv(names.RUN, "ours")
    for serves in ("", "ours"):
        assert world.report(agent, serves) is StartupPhase.LOAD
    assert world.report(agent, "theirs") is None
    assert world.bootstrap.missing() == [
        "the agent of host far works for a machine of the same ROS domain on another host (run theirs); stop that "
        "machine, or set another ROS_DOMAIN_ID"
    ]
    world.bootstrap.poll(world.now)
    assert world.bootstrap.state == machine_state.FAILED


class Processes(Agent):
    """Stand for the processes of a host; note which began and ended, in order."""

    def __init__(self, noted, commands, environment):
        super().__init__((), environment)
        self._noted = noted if commands else []

    def start(self):
        self._noted.append("begun")
        return []

    def shut_down(self):
        self._noted.append("ended")
        return []


@pytest.fixture
def host(ros, tmp_path, monkeypatch):
    """An agent, and a list of what it does."""
    noted = []
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    monkeypatch.setattr(agent_of_host, "Agent", partial(Processes, noted))
    deployment = parse_model(FAR, Deployment, name="d.yaml")
    node = agent_of_host.AgentNode(deployment, "far", SECRET)
    yield node, deployment, noted
    node.shut_down()
    node.destroy_node()


def test_an_agent_that_missed_the_end_of_a_run_carries_no_task_into_the_next(host):
    node, deployment, noted = host
    for run in ("first", "first", "second", "second"):
        node._follow(HostOrder(AgentOrder(int(StartupPhase.LOAD), {}), 60.0, options_text(deployment), run))
    assert noted == ["begun", "ended", "begun"]


class Leader:
    """Bootstrap of a run that orders the agent, and hears its reports."""

    def __init__(self, node, deployment, run):
        self._node, self._options, self._run = node, options_text(deployment), run
        self._link = SignedLink(SECRET, "far")

    def order(self, phase=StartupPhase.LOAD):
        """Order as an answer to a report of the agent, a shutdown at once, the rest after another report.

        Returns:
            The run that the next report names; None: the report is for another bootstrap.
        """
        reports = []
        self._node._publisher.publish = lambda report: reports.append(report.data)
        self._node._report([])
        sender = self._link.open(reports_topic("far"), reports.pop()).sender
        orders = [None, AgentOrder(int(phase), {})]
        for order in orders[phase is StartupPhase.SHUTDOWN :]:
            content = json.dumps(asdict(HostOrder(order, 60.0, self._options, self._run)))
            self._node._hear(String(data=self._link.sign(orders_topic("far"), content, sender)))
        if not reports:
            self._node._report([])
        opened = self._link.open(reports_topic("far"), reports.pop())
        return None if opened.content is None else json.loads(opened.content)["serves"]


@pytest.fixture
def leaders(host, monkeypatch):
    """Two bootstraps of different runs, and a function that lets time pass."""
    node, deployment, _ = host
    now = [100.0]
    monkeypatch.setattr(agent_of_host.clock, "monotonic", lambda: now[0])

    def wait(seconds):
        now[0] += seconds

    return *(Leader(node, deployment, run) for run in ("first", "second")), wait


def test_an_agent_keeps_to_its_bootstrap_and_tells_another_one_so(host, leaders):
    noted, (first, second, wait) = host[2], leaders
    for _ in range(20):
        assert first.order() == "first"
        wait(0.5)
        assert second.order() == "first"
        second.order(StartupPhase.SHUTDOWN)
    assert not host[0].finished
    assert noted == ["begun"]


def test_an_agent_takes_a_bootstrap_of_another_run_after_a_silence_and_blames_none_before(host, leaders):
    noted, (first, second, wait) = host[2], leaders
    assert first.order() == "first"
    wait(3.0)
    assert second.order() is None
    wait(4.0)
    assert second.order(StartupPhase.SHUTDOWN) is None
    assert second.order() == "second"
    assert noted == ["begun", "ended", "begun"]


def test_an_agent_takes_another_bootstrap_of_its_run_at_once(host, leaders):
    first, deployment = leaders[0], host[1]
    assert first.order() == "first"
    assert Leader(host[0], deployment, "first").order() == "first"
    assert host[2] == ["begun"]
