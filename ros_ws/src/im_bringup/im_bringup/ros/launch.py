"""``bootstrap``: start the processes of a deployment on the local host, then run ``/bootstrap`` as the leader.

The processes begin as copies of this one, which has loaded what all of them need, but not ROS: that brings threads
along, and with them no process may be copied.
"""

import argparse
import os
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path

from im_bringup.machine.bootstrap import Bootstrap
from im_bringup.machine.members import is_member
from im_bringup.machine.nets import PROVER, MachineNets
from im_bringup.tasks import deployment as deployments
from im_bringup.tasks.agent import MARKER, Agent, commands, environment
from im_bringup.tasks.deployment import Deployment
from im_bringup.tasks.host_digest import digests
from im_bringup.tasks.memory_limit import limit_memory
from im_bringup.tasks.middleware import middleware
from im_bringup.tasks.signed_link import read_secret
from im_cell.robot import load_cell
from im_core import clock, names, plugins
from im_core.errors import ConfigError, ImError
from im_core.processes import host_record, scheduling
from im_core.processes.process import prepare
from im_core.processes.procfs import ProcessId

#: What several processes load, beside what this one needs itself; of ROS its messages, which are plain Python.
COMMON = (
    *("im_cell.link", "im_cell.robot.truth", "pinocchio", "im_calibration", "im_mcs", "im_pnt_analysis.cli.verify"),
    *("im_pnt_node.journal.journal", "im_pnt_node.distributed.exchange", "im_pnt_node.ros.messages"),
    *("action_msgs.msg", "action_msgs.srv", "diagnostic_msgs.msg", "geometry_msgs.msg", "rcl_interfaces.msg"),
    *("rcl_interfaces.srv", "rosgraph_msgs.msg", "sensor_msgs.msg", "std_msgs.msg", "std_srvs.srv", "tf2_msgs.msg"),
    *("trajectory_msgs.msg", "type_description_interfaces.srv", "im_msgs.action", "im_msgs.msg", "im_msgs.srv"),
    *("concurrent.futures.thread", "logging"),
)


def main() -> int:
    """Run ``/bootstrap`` until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(prog="bootstrap", description="Start the tasks of a deployment; see start.")
    parser.add_argument("deployment")
    parser.add_argument("options", help="as JSON")
    arguments = parser.parse_args()
    if not is_member(ProcessId.current()):  # started by hand; the mark must be there from the start of a process
        os.execve(sys.executable, sys.orig_argv, {**os.environ, MARKER: names.instance()})

    try:
        deployment = deployments.load(arguments.deployment)
        limit_memory(deployment.memory_mib)
        os.environ.update(dds := middleware(os.environ, deployment))  # read when the first node is made
        if len(deployment.hosts) > 1:
            host_record.write(deployment.local_host(), False, names.run_dir().resolve(), dds)
        deployment = deployments.with_options_text(deployment, arguments.options, deployments.HERE)
        secret = read_secret(os.environ) if len(deployment.hosts) > 1 else b""
        nets, bootstrap = begin(deployment)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    from im_bringup.ros.bootstrap import run

    return run(deployment, Path(arguments.deployment).resolve(), nets, bootstrap, secret)


def begin(deployment: Deployment) -> tuple[MachineNets, Bootstrap]:
    """Start the processes of the local host.

    Returns:
        What finds out whether the nets of the tasks may run together, and what leads the tasks.

    Raises:
        ImError: One cannot be started, or their parameters not be written.
    """
    scheduling.keep_off()
    for module in COMMON:
        import_module(module)
    plugins.all_entries()
    with suppress(ConfigError):  # whoever needs it says what is wrong with it
        load_cell()
    prepare(PROVER)
    run_dir, host, tasks = names.run_dir().resolve(), deployment.local_host(), list(deployment.tasks())
    agent = Agent(commands(deployment, host, run_dir), environment(os.environ, run_dir, deployment))
    nets = MachineNets(run_dir, unproved=deployment.unproved)
    common = digests(deployment) if len(deployment.hosts) > 1 else {}
    bootstrap = Bootstrap(tasks, agent, host, nets, common)
    bootstrap.start(clock.monotonic())
    return nets, bootstrap


if __name__ == "__main__":
    sys.exit(main())
