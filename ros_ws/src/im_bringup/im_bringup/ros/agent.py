"""Node ``/agent_<host>``: the agent of a host other than the bootstrap's; follows the orders of the bootstrap."""

import argparse
import json
import math
import os
import socket
import sys
from dataclasses import asdict
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import String

from im_bringup.machine import run_state
from im_bringup.security.permissions import AGENT, ENCLAVE_OVERRIDE, enclave_arguments
from im_bringup.tasks import deployment as deployments
from im_bringup.tasks.agent import Agent, Died, commands, environment
from im_bringup.tasks.deployment import Deployment, agent_name, with_options_text
from im_bringup.tasks.host_digest import digests
from im_bringup.tasks.memory_limit import limit_memory
from im_bringup.tasks.middleware import has_link, middleware, require_addresses
from im_bringup.tasks.registry import Progress
from im_bringup.tasks.signed_link import (
    HostOrder,
    HostReport,
    SignedLink,
    orders_topic,
    read_secret,
    reports_topic,
)
from im_bringup.tasks.upkeep import Upkeep
from im_core import clock, names
from im_core.executables import INTERRUPTED
from im_core.message_paths import MORE_FOLDERS, handed_over
from im_core.processes import host_record
from im_core.processes.agent_socket import TaskReport
from im_core.processes.startup import START_TIMEOUT, StartupPhase
from im_core.ros import qos, run
from im_core.ros.guard import GuardedNode
from im_core.ros.parameters import describe_sim_time
from im_core.text.bounded_json import member, read_json
from im_msgs.msg import TaskStatus

#: How often the agent looks at its processes while they start, and from then on [s].
STARTING_PERIOD_S, POLL_PERIOD_S = 0.05, 0.2
#: How often the bootstrap hears of this host at least [s].
REPORT_PERIOD_S = 0.5
#: How long a bootstrap must be silent before one of another run may order [s]; until when it surely lives [s].
_SILENT_S, _ALIVE_S = 6.0, 1.5
#: How often an agent without a link to others looks whether there is one [s].
_LINK_PERIOD_S = 0.2


class AgentNode(GuardedNode):
    """Node of an agent: starts the host's tasks once the bootstrap is there, stops all at the bootstrap's request.

    Args:
        deployment: The deployment, the same as the bootstrap's but for what its start was given.
        host: Name of this host in it.
        secret: What this host shares with that of the bootstrap.
    """

    def __init__(self, deployment: Deployment, host: str, secret: bytes) -> None:
        super().__init__(agent_name(host))
        describe_sim_time(self)
        self.log: RcutilsLogger = self.get_logger()
        run_dir = names.run_dir().resolve() / host
        commands(deployment, host, run_dir)  # what is missing is said now, and not when all others start
        self._deployment, self._host, self._run_dir = deployment, host, run_dir
        self._agent = Agent((), os.environ)
        spared = [Path(deployment.calibration)] if deployment.calibration else []
        self._upkeep = Upkeep(run_dir, names.results_dir(), deployment.keep, spared, self.log.warning)
        self._upkeep.start()
        self._link = SignedLink(secret, host)
        self._reports: dict[str, tuple[TaskReport, int]] = {}
        self._incarnations: dict[str, int] = {}
        self._digests = digests(deployment)
        self._report_at = 0.0
        self._started, self._run, self._serves = False, "", ""
        self._ordered_at = -math.inf
        self.finished = False
        self._publisher = self.create_publisher(String, reports_topic(host), qos.EVENTS)
        self.create_subscription(String, orders_topic(host), self._hear, qos.EVENTS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._poll_timer = self.create_timer(STARTING_PERIOD_S, self._poll, clock=steady)
        self.log.info(f"host {host} waits for the bootstrap")

    def shut_down(self) -> None:
        """Stop all tasks of the local host, the last started first."""
        self._upkeep.stop()
        self._end_tasks()
        host_record.remove()

    def _end_tasks(self) -> None:
        for name in self._agent.shut_down():
            self.log.warning(f"process {name} did not end and was killed")

    def _hear(self, message: String) -> None:
        topic = orders_topic(self._host)
        opened = self._link.open(topic, message.data, self._is_free_for)
        if opened.content is not None:
            told = read_json(HostOrder, opened.content, topic)
            self._ordered_at, self._serves = clock.monotonic(), told.run
            self._follow(told)
        elif opened.refused and clock.monotonic() < self._ordered_at + _ALIVE_S:
            self._report([], opened.sender)  # it learns which run this agent is of

    def _is_free_for(self, order: str) -> bool:
        """Check whether a new bootstrap may order: one of the same run, or one that starts after a silence."""
        told = read_json(HostOrder, order, orders_topic(self._host))
        if not self._started or told.run == self._serves:
            return True
        silent = clock.monotonic() > self._ordered_at + _SILENT_S
        return silent and (told.order is None or told.order.phase != StartupPhase.SHUTDOWN)

    def _report(self, tasks: list[tuple[TaskReport, int]], receiver: str | None = None) -> None:
        """Report to an incarnation of the bootstrap; None: to the present one."""
        topic, report = reports_topic(self._host), HostReport(tasks, self._digests, self._serves)
        self._publisher.publish(String(data=self._link.sign(topic, json.dumps(asdict(report)), receiver)))

    def _follow(self, told: HostOrder) -> None:
        """Carry out the order of the bootstrap."""
        if told.order is None:
            self._report_at = 0.0
            return
        phase = member(StartupPhase, told.order.phase, "the phase that the bootstrap orders")
        if phase is StartupPhase.SHUTDOWN:
            self.finished = self._started and told.run == self._run
            return
        if self._started and told.run != self._run:  # it has not heard of the end of the former run
            self.log.warning("another run of the machine has begun: the tasks of the former one end")
            self._end_tasks()
            self._reports.clear()
            self._incarnations.clear()
            self._started = False
        if not self._started:
            deployment = with_options_text(self._deployment, told.options)
            # clients of this host hand files over in its run folder, and not in that of its tasks
            folders = os.pathsep.join(filter(None, (os.environ.get(MORE_FOLDERS), str(handed_over().resolve()))))
            given = {START_TIMEOUT: repr(told.start_timeout_s), names.RUN: told.run, MORE_FOLDERS: folders}
            given = {**environment(os.environ, self._run_dir, deployment), **given}
            # a new machine is a new mission; an agent of the run that comes back goes on with its own
            fresh = not told.run or run_state.run_of(self._run_dir) != told.run
            run_state.prepare(self._run_dir, fresh, self.log.info)
            run_state.begin(self._run_dir, told.run)
            self._started, self._run = True, told.run
            self._agent = Agent(commands(deployment, self._host, self._run_dir), given)
            for event in self._agent.start():
                self.log.info(str(event))
        self._agent.order(told.order)
        if phase is StartupPhase.START:
            self._agent.respawn = True
            self._poll_timer.timer_period_ns = round(POLL_PERIOD_S * 1e9)

    def _poll(self) -> None:
        now = clock.monotonic()
        for report, pid in self._agent.reports():
            self._reports[report.task] = report, pid
            self._incarnations[report.task] = report.incarnation
            if report.phase == TaskStatus.FAILED:
                self._agent.replace(report.task, pid, report.detail, now)
        for event in self._agent.poll(now):
            if isinstance(event, Died):
                self.log.error(str(event))
                for task in event.tasks:
                    known = self._incarnations.get(task, 0)
                    self._reports[task] = TaskReport(task, known, Progress.DEAD, event.sentence), 0
        if self._reports or now >= self._report_at:
            self._report_at = now + REPORT_PERIOD_S
            self._report(list(self._reports.values()))
            self._reports.clear()
        if self.finished:
            rclpy.try_shutdown()


def main() -> int:
    """Run the agent until SIGINT, SIGTERM or the end of the machine."""
    parser = argparse.ArgumentParser(
        prog="agent",
        description="Run the tasks of one host of a deployment; the bootstrap runs on another host. Both need the same "
        "secret, a file of mode 0600 that IM_SECRET_FILE names (default: ~/.config/im/secret); see docs/security.md.",
    )
    parser.add_argument("host", help="name of this host in the deployment")
    parser.add_argument("deployment", nargs="?", default=str(deployments.default_path()))
    arguments = parser.parse_args()

    def make_node() -> AgentNode:
        deployment, secret = deployments.load(arguments.deployment), read_secret(os.environ)
        _await_link(deployment.addresses.get(arguments.host, ""))
        require_addresses(deployment, Path(arguments.deployment))
        limit_memory(deployment.memory_mib)
        os.environ.update(dds := middleware(os.environ, deployment))  # read when the first node is made
        host_record.write(arguments.host, True, names.run_dir().resolve() / arguments.host, dds)
        print(f"agent: host {arguments.host} waits for orders of the bootstrap", flush=True)
        return AgentNode(deployment, arguments.host, secret)

    os.environ.pop(ENCLAVE_OVERRIDE, None)  # that is of clients
    enclave = enclave_arguments(arguments.host, AGENT)
    try:
        return run.main(make_node, args=enclave, at_end=AgentNode.shut_down)
    except KeyboardInterrupt:  # it waited for a link
        return INTERRUPTED


def _await_link(address: str) -> None:
    """Wait for the link to other hosts, as long as need be, as for the bootstrap."""
    try:
        known = socket.gethostbyname(address) if address else ""
    except OSError:  # its name is not known without the link, perhaps
        known = ""
    if not has_link(known):
        print(f"agent: no link to other hosts is up{f' at {address}' if address else ''}; waiting for it", flush=True)
        while not has_link(known):
            clock.sleep(_LINK_PERIOD_S)


if __name__ == "__main__":
    sys.exit(main())
