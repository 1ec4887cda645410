"""ROS shell of the Vision Services System."""
