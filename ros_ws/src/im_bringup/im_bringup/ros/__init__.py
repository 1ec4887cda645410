"""ROS shells: nodes of the bootstrap and the agents, and commands acting as ROS clients."""
