"""Contents of the cell, for moving, seeing, calibrating or simulating; depends on ``im_core`` only.

- :mod:`im_cell.robot`: geometry and dynamics of robots, cameras, targets and lights, as drawn;
- :mod:`im_cell.camera_model`, :mod:`im_cell.laser_model`, :mod:`im_cell.sensor`, :mod:`im_cell.psf`,
  :mod:`im_cell.fiducial`: how cameras and laser scanner image;
- :mod:`im_cell.frames`: images and where they come from;
- :mod:`im_cell.rotations`: quaternions, rotation vectors and matrices;
- :mod:`im_cell.calibration_files`, :mod:`im_cell.calibration_error`, :mod:`im_cell.workspace`: calibrations as files,
  and how wrong one is over the workspace;
- :mod:`im_cell.link`: the ends of the link to the simulated testbed.
"""
