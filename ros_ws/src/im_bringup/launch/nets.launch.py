"""Nets alone, on a robot of your own whose nodes offer what they call (docs/tutorials/your_robot.md); Ctrl-C ends them.

    nets.launch.py nets:="pick.yaml cell.yaml" page:=true

It imports launch alone, whose Python need not be that of the workspace.
"""

import shlex
from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration

VALUES = {
    "journal": "folder in which a node that is killed finds where it was; empty: none is kept",
    "name": "name of the node; empty: that of the first net",
    "seed": "seed of choices among transitions; empty: 0",
}
SWITCHES = {
    "page": "show the nets live on a web page",
    "use_sim_time": "take the time from /clock",
}
END_S = "60"
"""How long the goals under way may take to end when they are cancelled [s]."""


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the start of the node."""
    nets = DeclareLaunchArgument("nets", description="net files, separated by blanks; they are verified together")
    values = [DeclareLaunchArgument(name, default_value="", description=text) for name, text in VALUES.items()]
    switches = [
        DeclareLaunchArgument(name, default_value="false", choices=["true", "false"], description=text)
        for name, text in SWITCHES.items()
    ]
    return LaunchDescription([nets, *values, *switches, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list[ExecuteProcess]:
    given = {name: LaunchConfiguration(name).perform(context) for name in ("nets", *VALUES, *SWITCHES)}
    command = [str(Path(get_package_prefix("im_pnt_node")) / "lib" / "im_pnt_node" / "pnt_node")]
    command += shlex.split(given["nets"])
    command += [f"--{name}={given[name]}" for name in VALUES if given[name]]
    command += ["--page"] if given["page"] == "true" else []
    command += ["--ros-args", "-p", f"use_sim_time:={given['use_sim_time']}"]
    ended = Shutdown(reason="the nets have ended")
    return [ExecuteProcess(cmd=command, output="screen", sigterm_timeout=END_S, sigkill_timeout=END_S, on_exit=ended)]
