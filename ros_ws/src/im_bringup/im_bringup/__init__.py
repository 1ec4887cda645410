"""Start, stop, recording and replay of the Intelligent Machine; depends on ``im_core`` and ``im_cell`` only.

- :mod:`im_bringup.tasks`: the deployment file, executables, the agent of a host, the registry of all tasks;
- :mod:`im_bringup.machine`: bootstrap, ``start`` and ``stop``, the record of a machine, leftovers of a killed one;
- :mod:`im_bringup.calibration`: the true error of a calibration in simulation;
- :mod:`im_bringup.ros`: nodes and commands that speak ROS;
- ``deployments`` and ``config``: the shipped deployment files, and what every process finds in its environment.
"""
