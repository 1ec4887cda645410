"""The simulated testbed: two PUMAs on carts in pybullet, driven by torques, behind the testbed link.

Nobody imports it: others meet its processes through :mod:`im_cell.link`, :mod:`im_cell.frames` and topics. It knows
``im_core`` and ``im_cell``.

- :mod:`im_sim.physics`, :mod:`im_sim.loop`: the physics process, tick by tick;
- :mod:`im_sim.plant`: all that a tick moves: :mod:`im_sim.world` (pybullet), :mod:`im_sim.dynamics`,
  ``im_sim.actuators``, :mod:`im_sim.brakes`, :mod:`im_sim.grippers`; read by :mod:`im_sim.sensors`;
- :mod:`im_sim.exposures`, :mod:`im_sim.laser`: what a shutter sees, and the laser scanner;
- :mod:`im_sim.truth`: draws what the cell is really like; :mod:`im_sim.panel`: faults, objects and lights by name;
- :mod:`im_sim.cameras`: the cameras, a process of their own;
- :mod:`im_sim.ros`: the node ``/testbed``.
"""
