"""ROS shells: the bootstrap and agent nodes, and the commands that are ROS clients."""
