"""Agents of other hosts, seen from the bootstrap: signed orders to each agent, and reports of the tasks."""

import json
import os
from collections.abc import Collection
from dataclasses import asdict
from functools import partial

from rclpy.duration import Duration
from std_msgs.msg import String

from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.tasks.signed_link import HostOrder, HostReport, SignedLink, orders_topic, reports_topic
from im_core import clock, names
from im_core.processes.startup import start_timeout_s
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.repeated_warnings import Reminders
from im_core.text.bounded_json import read_json

ACKNOWLEDGED_S = 2.0


class RemoteAgents:
    """Sender of orders to the agents of other hosts, and receiver of the agents' reports.

    An agent asks by reporting; the answer names the incarnation of the agent that asked.
    """

    def __init__(
        self, node: GuardedNode, bootstrap: Bootstrap, hosts: Collection[str], options: str, secret: bytes
    ) -> None:
        self._bootstrap, self._options = bootstrap, options
        self._reminders, self._warned = Reminders(node), dict.fromkeys(hosts, "")
        self._links = {host: SignedLink(secret, host) for host in hosts}
        self._sent = dict.fromkeys(hosts, "")
        self._publishers = {host: node.create_publisher(String, orders_topic(host), qos.EVENTS) for host in hosts}
        for host in hosts:
            node.create_subscription(String, reports_topic(host), partial(self._hear, host), qos.EVENTS)

    def order(self) -> None:
        """Send each agent the changed orders."""
        for host, link in self._links.items():
            if link.peer and self._content(host) != self._sent[host]:
                self._send(host, link.peer)

    def acknowledged(self) -> bool:
        """Wait at most :data:`ACKNOWLEDGED_S` until all agents have acknowledged; return whether all did."""
        deadline = clock.monotonic() + ACKNOWLEDGED_S
        return all(
            publisher.wait_for_all_acked(Duration(seconds=max(0.0, deadline - clock.monotonic())))
            for publisher in self._publishers.values()
        )

    def _content(self, host: str) -> str:
        order = HostOrder(self._bootstrap.order(host), start_timeout_s(), self._options, os.environ.get(names.RUN, ""))
        return json.dumps(asdict(order))

    def _send(self, host: str, receiver: str) -> None:
        self._sent[host] = content = self._content(host)
        signed = self._links[host].sign(orders_topic(host), content, receiver)
        self._publishers[host].publish(String(data=signed))

    def _warn(self, host: str, sentence: str) -> None:
        if sentence == self._warned[host]:
            return
        self._warned[host] = sentence
        self._reminders.end(host)
        if sentence:
            self._reminders.add(host, sentence)

    def _hear(self, host: str, message: String) -> None:
        topic = reports_topic(host)
        opened = self._links[host].open(topic, message.data)
        if opened.content is not None:
            told = read_json(HostReport, opened.content, topic)
            unlike = self._bootstrap.agent_heard(host, told.digests, clock.monotonic())
            self._warn(host, unlike)
            if unlike:
                return
            for report, pid in told.tasks:
                self._bootstrap.reported(report, pid, host, clock.monotonic())
        self._send(host, opened.sender)
