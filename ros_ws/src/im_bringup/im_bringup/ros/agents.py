"""Agents of other hosts, seen from the bootstrap: signed orders to each agent, and reports of the tasks."""

import json
import math
import os
from collections.abc import Collection
from dataclasses import asdict, dataclass, field
from functools import partial

from rclpy.duration import Duration
from rclpy.publisher import Publisher
from std_msgs.msg import String

from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.tasks.signed_link import HostOrder, HostReport, SignedLink, orders_topic, reports_topic
from im_core import clock, names
from im_core.errors import DataError
from im_core.processes.agent_socket import AgentOrder
from im_core.processes.startup import StartupPhase, start_timeout_s
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.repeated_warnings import Reminders
from im_core.text.bounded_json import read_json

ACKNOWLEDGED_S = 2.0
#: How long an agent must be silent before another one of its host is given orders [s].
_REPLACED_AFTER_S = 2.0


@dataclass
class _RemoteAgent:
    """Agent of a host: the link to it, and what was sent and heard.

    Attributes:
        host: Name of the host.
        link: Signed link to the agent.
        publisher: Publisher of the orders.
        sent: Content of the last order.
        invited: Incarnation of the agent last answered for the first time.
        heard: Time of the last report, or of the invitation [s].
        second: Time at which another agent of the host was last heard [s].
        replaced: Incarnations replaced by others.
        warned: Warning in force; empty if none is.
    """

    host: str
    link: SignedLink
    publisher: Publisher
    sent: str = ""
    invited: str = ""
    heard: float = -math.inf
    second: float = -math.inf
    replaced: set[str] = field(default_factory=set)
    warned: str = ""

    def publish(self, content: str, receiver: str) -> None:
        """Publish a signed order to an incarnation of the agent."""
        self.publisher.publish(String(data=self.link.sign(orders_topic(self.host), content, receiver)))

    def second_sentence(self, now: float) -> str:
        """Return the warning of a second agent heard lately; empty if there is none."""
        second = now < self.second + _REPLACED_AFTER_S
        return f"host {self.host} has a second agent, which gets no orders: end one of the two" if second else ""


class RemoteAgents:
    """Sender of orders to the agents of other hosts, and receiver of the agents' reports.

    An agent asks by reporting; the answer names the incarnation of the agent that asked. A host has one agent: another
    one gets no orders while the first is heard, and one that was replaced is told to end.
    """

    def __init__(
        self, node: GuardedNode, bootstrap: Bootstrap, hosts: Collection[str], options: str, secret: bytes
    ) -> None:
        self._bootstrap, self._options, self._reminders = bootstrap, options, Reminders(node)
        self._agents = [
            _RemoteAgent(host, SignedLink(secret, host), node.create_publisher(String, orders_topic(host), qos.EVENTS))
            for host in hosts
        ]
        for agent in self._agents:
            node.create_subscription(String, reports_topic(agent.host), partial(self._hear, agent), qos.EVENTS)

    def order(self) -> None:
        """Send each agent the changed orders."""
        for agent in self._agents:
            if agent.sent and self._content(self._bootstrap.order(agent.host)) != agent.sent:
                self._send(agent)

    def acknowledged(self) -> bool:
        """Wait at most :data:`ACKNOWLEDGED_S` until all agents have acknowledged; return whether all did."""
        deadline = clock.monotonic() + ACKNOWLEDGED_S
        return all(
            agent.publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - clock.monotonic())))
            for agent in self._agents
        )

    def _content(self, order: AgentOrder | None) -> str:
        run = os.environ.get(names.RUN, "")
        return json.dumps(asdict(HostOrder(order, start_timeout_s(), self._options, run)))

    def _send(self, agent: _RemoteAgent) -> None:
        agent.sent = self._content(self._bootstrap.order(agent.host))
        agent.publish(agent.sent, agent.link.peer)

    def _warn(self, agent: _RemoteAgent, sentence: str) -> None:
        if sentence == agent.warned:
            return
        agent.warned = sentence
        self._reminders.end(agent.host)
        if sentence:
            self._reminders.add(agent.host, sentence)

    def _hear(self, agent: _RemoteAgent, message: String) -> None:
        host, link, now = agent.host, agent.link, clock.monotonic()
        before, topic = link.peer, reports_topic(host)
        try:
            opened = link.open(topic, message.data)
        except DataError as error:
            self._bootstrap.stranger_heard(host, error.message)
            raise
        if link.peer != before:
            agent.replaced |= {before} - {""}
        if opened.sender in agent.replaced:
            agent.publish(self._content(AgentOrder(int(StartupPhase.SHUTDOWN), {})), opened.sender)
            return
        if opened.sender not in (link.peer, agent.invited):
            if now < agent.heard + _REPLACED_AFTER_S:
                agent.second = now
                self._warn(agent, agent.second_sentence(now))
                return
            agent.invited, agent.heard = opened.sender, now
        if opened.content is None:  # an old one, perhaps: only an answer tells what the host has now
            agent.publish(self._content(None), opened.sender)
        else:
            agent.heard = now
            told = read_json(HostReport, opened.content, topic)
            serves = told.serves if told.serves != os.environ.get(names.RUN, "") else ""
            unlike = self._bootstrap.agent_heard(host, told.digests, now, serves)
            self._warn(agent, unlike or agent.second_sentence(now))
            if unlike:
                agent.sent = ""
                return
            for report, pid in told.tasks:
                self._bootstrap.reported(report, pid, host, now)
            self._send(agent)
