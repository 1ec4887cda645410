"""RViz on the running machine of this ROS domain: robot, frames, images, markers.

    view.launch.py

RViz comes with an installed ROS.
"""

import os
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def generate_launch_description() -> LaunchDescription:
    """Declare the configuration, and RViz with the time and the reach of the machine."""
    shipped = str(Path(get_package_share_directory("im_bringup")) / "rviz" / "cell.rviz")
    config = DeclareLaunchArgument("config", default_value=shipped, description="configuration of RViz")
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", LaunchConfiguration("config")],
        parameters=[{"use_sim_time": True}],
        additional_env={"ROS_AUTOMATIC_DISCOVERY_RANGE": os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")},
        output="screen",
        on_exit=Shutdown(reason="RViz was closed"),
    )
    return LaunchDescription([config, rviz])
