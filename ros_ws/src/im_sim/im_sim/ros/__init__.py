"""ROS shell of the simulated testbed."""
