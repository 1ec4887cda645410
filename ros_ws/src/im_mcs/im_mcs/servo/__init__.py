"""Servo loop: all layers once a tick, in a separate process without ROS (``python -m im_mcs.servo``)."""
