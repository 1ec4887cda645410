"""Motion Control System (paper, section 4), a folder a layer.

- :mod:`im_mcs.testbed`: testbed interface layer, slots and channel drivers;
- :mod:`im_mcs.control`: motion control layer, setpoints to torques;
- :mod:`im_mcs.planning`: motion planning layer, requests to setpoints;
- :mod:`im_mcs.client`: client interface layer, what may be asked for;
- :mod:`im_mcs.state`: state manager, which spans the layers;
- :mod:`im_mcs.servo`: the loop that runs them all, in a process of its own;
- :mod:`im_mcs.ros`: the ROS shell.

This is not a safety-rated system.
"""
