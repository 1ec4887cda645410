"""What the ROS shells of all packages share."""
