"""ROS shell of the display."""
