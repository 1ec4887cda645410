"""The simulated cameras: a separate process without ROS (``python -m im_sim.cameras``), and the host.

:class:`~im_sim.cameras.host.CameraHost` is the frame source that ``vss.yaml`` names: it starts the process and talks to
it through shared memory. Of the testbed the process reads what a shutter sees through the link, and the truth of lenses
and lights, which no vision software may know.
"""
