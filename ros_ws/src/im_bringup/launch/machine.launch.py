"""Machine of this ROS domain in the foreground, started as by scripts/start.sh; Ctrl-C stops it.

    machine.launch.py factor:=0 seed:=7

It imports launch alone, whose Python need not be that of the workspace.
"""

from pathlib import Path

from ament_index_python.packages import get_package_prefix
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration

VALUES = {
    "deployment": "deployment file; empty: the one of im_bringup",
    "factor": "simulated seconds a second, 0: as fast as it goes; empty: as in the deployment",
    "period": "period of servo and testbed [s], e.g. 0.001; empty: as in the deployment",
    "seed": "seed of all random numbers; empty: as in the deployment",
    "port": "TCP port of the display, the next free one if in use; empty: as in the deployment",
    "foxglove": "TCP port that Foxglove connects to, e.g. 8765; empty: as in the deployment",
    "cell": "file of robot, cameras, lights and scenery; empty: as in the deployment",
    "calibration": "folder of calibrations to start with; empty: as in the deployment",
    "timeout": "longest wait for the machine [s]; empty: 60",
}
SWITCHES = {
    "perfect_arm": "let the simulated arms be as drawn, not off by 0.3 to 1 mm",
    "control": "let the display operate nets",
    "unproved": "start even if the verification of the nets ends without a verdict",
    "resume": "resume all unfinished commands at once",
    "fresh": "begin a new mission, set unfinished commands aside",
}
END_S = "20"
"""How long the machine may take to stop, longer than launch waits by itself [s]."""


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and the start of the machine."""
    values = [DeclareLaunchArgument(name, default_value="", description=text) for name, text in VALUES.items()]
    switches = [
        DeclareLaunchArgument(name, default_value="false", choices=["true", "false"], description=text)
        for name, text in SWITCHES.items()
    ]
    return LaunchDescription([*values, *switches, OpaqueFunction(function=_start)])


def _start(context: LaunchContext) -> list[ExecuteProcess]:
    given = {name: LaunchConfiguration(name).perform(context) for name in (*VALUES, *SWITCHES)}
    deployment = given.pop("deployment")
    command = [str(Path(get_package_prefix("im_bringup")) / "lib" / "im_bringup" / "start"), "--foreground"]
    command += [f"--{name}={given[name]}" for name in VALUES if given.get(name)]
    command += [f"--{name.replace('_', '-')}" for name in SWITCHES if given[name] == "true"]
    command += [deployment] if deployment else []
    ended = Shutdown(reason="the machine has ended")
    return [ExecuteProcess(cmd=command, output="screen", sigterm_timeout=END_S, sigkill_timeout=END_S, on_exit=ended)]
