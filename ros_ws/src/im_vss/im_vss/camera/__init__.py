"""The simulated cameras: a process of its own without ROS (``python -m im_vss.camera``) and the way to it.

It plays the hardware. :class:`~im_vss.camera.host.CameraHost` starts it and talks to it through shared memory.
"""
