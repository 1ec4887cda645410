"""Requests to a node: commands from all of ROS, and the operator's."""
