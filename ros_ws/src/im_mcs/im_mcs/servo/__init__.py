"""The servo loop: all layers once a tick, in a process of its own without ROS (``python -m im_mcs.servo``)."""
