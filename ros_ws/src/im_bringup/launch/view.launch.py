"""RViz on the running machine of this ROS domain: robot, frames, images, markers.

    view.launch.py cell:=panda

RViz comes with an installed ROS.
"""

import os

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from im_cell.robot import load_cell
from im_core import names
from im_mcs.cell.views import rviz_config


def generate_launch_description() -> LaunchDescription:
    """Declare the cell, a configuration in place of the cell's, and RViz."""
    told = "cell file, or name of a shipped cell; empty: the default one"
    cell = DeclareLaunchArgument("cell", default_value="", description=told)
    config = DeclareLaunchArgument("config", default_value="", description="configuration of RViz; empty: the cell's")
    return LaunchDescription([cell, config, OpaqueFunction(function=_rviz)])


def _rviz(context: LaunchContext) -> list[Node]:
    """Return RViz with the time and the reach of the machine."""
    config = LaunchConfiguration("config").perform(context)
    if not config:
        cell = load_cell(LaunchConfiguration("cell").perform(context) or None)
        file = names.run_dir() / "cell.rviz"
        file.write_text(rviz_config(cell), encoding="utf-8")
        config = str(file)
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", config],
        parameters=[{"use_sim_time": True}],
        additional_env={"ROS_AUTOMATIC_DISCOVERY_RANGE": os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")},
        output="screen",
        on_exit=Shutdown(reason="RViz was closed"),
    )
    return [rviz]
