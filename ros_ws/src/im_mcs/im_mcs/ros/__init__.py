"""ROS shell of MCS."""
