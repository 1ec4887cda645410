"""From the tasks of a deployment to the commands that start them."""

from collections.abc import Mapping
from pathlib import Path

import yaml

from im_bringup.agent import Command
from im_bringup.deployment import Deployment, ParameterValue
from im_bringup.executables import path_of
from im_bringup.leftovers import MARKER
from im_core import names, scheduling


def commands(deployment: Deployment, host: str, run_dir: Path) -> list[Command]:
    """Commands for the tasks of one host, in starting order; their parameter files are written.

    Args:
        deployment: The deployment.
        host: Name of the host in it.
        run_dir: Folder for parameter files and logs.

    Raises:
        NotFoundError: The host, a package or an executable does not exist.
    """
    result = []
    for placed in deployment.on_host(host):
        program = path_of(placed.task.package, placed.task.executable)
        parameters = write_parameters(run_dir, placed.name, deployment.parameters_of(placed.task))
        argv = [str(program), "--ros-args", "--disable-external-lib-logs", "--params-file", str(parameters)]
        result.append(Command(placed.name, argv, run_dir / "log" / f"{placed.name}.log"))
    return result


def write_parameters(run_dir: Path, task: str, parameters: Mapping[str, ParameterValue]) -> Path:
    """Write a ROS parameter file that holds for every node of the task's process."""
    path = run_dir / "parameters" / f"{task}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    content = {"/**": {"ros__parameters": dict(parameters)}}
    path.write_text(yaml.safe_dump(content, sort_keys=True), encoding="utf-8")
    return path


def environment(base: Mapping[str, str], run_dir: Path, deployment: Deployment) -> dict[str, str]:
    """Environment of the machine's processes: marked as belonging to it, with its folder, and the core of its servo."""
    core = scheduling.reserve() if deployment.clock_factor > 0.0 else {}
    return {**base, **core, MARKER: names.instance(), "IM_RUN_DIR": str(run_dir)}
