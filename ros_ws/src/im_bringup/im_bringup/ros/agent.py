"""Node ``/agent_<host>``: the agent of a host other than the bootstrap's; it follows the phases of the bootstrap."""

import argparse
import math
import os
import re
import sys
from pathlib import Path

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import Float64, String, UInt8

from im_bringup.machine import mission
from im_bringup.tasks import deployment as deployments
from im_bringup.tasks.agent import Agent, Died, commands, environment
from im_bringup.tasks.deployment import Deployment, with_options_text
from im_bringup.tasks.memory_limit import limit_memory
from im_bringup.tasks.middleware import middleware
from im_bringup.tasks.upkeep import Upkeep
from im_core import clock, names
from im_core.arrivals import member
from im_core.errors import DataError
from im_core.ros import qos, run
from im_core.ros.guard import GuardedNode
from im_core.ros.parameters import describe_sim_time
from im_core.startup import OPTIONS_TOPIC, PHASE_TOPIC, START_TIMEOUT, STATUS_TOPIC, TIMEOUT_TOPIC, StartupPhase
from im_msgs.msg import TaskStatus

#: How often the agent looks at its processes while they start, and from then on [s].
STARTING_PERIOD_S, POLL_PERIOD_S = 0.05, 0.2


class AgentNode(GuardedNode):
    """Starts the tasks of its host when the bootstrap is there, and stops them when it says so.

    Args:
        deployment: The deployment, the same as the bootstrap's but for what its start was given.
        host: Name of this host in it.
    """

    def __init__(self, deployment: Deployment, host: str) -> None:
        super().__init__("agent_" + re.sub(r"\W", "_", host))
        describe_sim_time(self)
        self.log: RcutilsLogger = self.get_logger()
        run_dir = names.run_dir().resolve() / host
        mission.prepare(run_dir, True, self.log.info)  # a new machine is a new mission
        commands(deployment, host, run_dir)  # what is missing is said now, and not when all others start
        self._deployment, self._host, self._run_dir = deployment, host, run_dir
        self._agent = Agent((), os.environ)
        spared = [Path(deployment.calibration)] if deployment.calibration else []
        self._upkeep = Upkeep(run_dir, names.results_dir(), deployment.keep, spared, self.log.warning)
        self._upkeep.start()
        self._phase: StartupPhase | None = None
        self._timeout_s: float | None = None
        self._told: Deployment | None = None
        self._started = False
        self.finished = False
        self.create_subscription(Float64, TIMEOUT_TOPIC, self._take_timeout, qos.LATCHED)
        self.create_subscription(String, OPTIONS_TOPIC, self._take_options, qos.LATCHED)
        self.create_subscription(UInt8, PHASE_TOPIC, self._follow, qos.LATCHED)
        self.create_subscription(TaskStatus, STATUS_TOPIC, self._status, qos.STATUS)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._poll_timer = self.create_timer(STARTING_PERIOD_S, self._poll, clock=steady)
        self.log.info(f"host {host} waits for the bootstrap")

    def shut_down(self) -> None:
        """Stop all tasks of this host, the last started first."""
        self._upkeep.stop()
        for name in self._agent.shut_down():
            self.log.warning(f"process {name} did not end and was killed")

    def _take_timeout(self, message: Float64) -> None:
        if not 0.0 < message.data < math.inf:
            raise DataError(f"{message.data} s on {TIMEOUT_TOPIC} is no time to start in", seconds=message.data)
        self._timeout_s = message.data
        self._advance()

    def _take_options(self, message: String) -> None:
        self._told = with_options_text(self._deployment, message.data)
        self._advance()

    def _follow(self, message: UInt8) -> None:
        self._phase = member(StartupPhase, message.data, f"on {PHASE_TOPIC} phase")
        self._advance()

    def _advance(self) -> None:
        """Do what the bootstrap asks for; nothing starts before it has told what its start was given."""
        if self._phase is StartupPhase.SHUTDOWN:
            self.finished = self._started
        elif not self._started and None not in (self._phase, self._timeout_s, self._told):
            assert self._told is not None
            self._started = True
            told = {**environment(os.environ, self._run_dir, self._told), START_TIMEOUT: repr(self._timeout_s)}
            self._agent = Agent(commands(self._told, self._host, self._run_dir), told)
            for event in self._agent.start():
                self.log.info(str(event))
        if self._phase is StartupPhase.START:
            self._agent.respawn = True
            self._poll_timer.timer_period_ns = round(POLL_PERIOD_S * 1e9)

    def _status(self, message: TaskStatus) -> None:
        if message.phase == TaskStatus.FAILED:
            self._agent.replace(message.name, message.pid, message.detail, clock.monotonic())

    def _poll(self) -> None:
        for event in self._agent.poll(clock.monotonic()):
            if isinstance(event, Died):
                self.log.error(str(event))
        if self.finished:
            rclpy.try_shutdown()


def main() -> int:
    """Run the agent until SIGINT, SIGTERM or the end of the machine."""
    parser = argparse.ArgumentParser(
        prog="agent", description="Run the tasks of one host of a deployment; the bootstrap runs on another host."
    )
    parser.add_argument("host", help="name of this host in the deployment")
    parser.add_argument("deployment", nargs="?", default=str(deployments.default_path()))
    arguments = parser.parse_args()

    def make_node() -> AgentNode:
        deployment = deployments.load(arguments.deployment)
        limit_memory(deployment.memory_mib)
        os.environ.update(middleware(os.environ, deployment))  # read when the first node is made
        return AgentNode(deployment, arguments.host)

    return run.main(make_node, args=[], at_end=AgentNode.shut_down)


if __name__ == "__main__":
    sys.exit(main())
