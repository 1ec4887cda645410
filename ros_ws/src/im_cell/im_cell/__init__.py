"""Contents of the cell, for moving, seeing, calibrating or simulating; depends on ``im_core`` only.

- :mod:`im_cell.robot`: geometry and dynamics of robots, cameras, targets and lights, as drawn;
- :mod:`im_cell.camera_model`, :mod:`im_cell.laser_model`, :mod:`im_cell.sensor`, :mod:`im_cell.psf`,
  :mod:`im_cell.fiducial`: how cameras and laser scanner image;
- :mod:`im_cell.frames`: images and where they come from;
- :mod:`im_cell.rotations`: quaternions, rotation vectors and matrices;
- :mod:`im_cell.calibration_files`, :mod:`im_cell.calibration_report`, :mod:`im_cell.calibration_error`,
  :mod:`im_cell.workspace`: calibrations as files and in messages, and how wrong one is over the workspace;
- :mod:`im_cell.link`: the ends of the link to the simulated testbed.

The cell as drawn, and a camera 3 m above the floor; the examples of the modules go on with these variables:

    >>> import numpy as np
    >>> from im_cell.camera_model import CameraModel
    >>> from im_cell.robot import load_cell
    >>> cell = load_cell()
    >>> len(cell.joints), cell.joint_names[:3], cell.light_names
    (18, ('left_track', 'left_rotation', 'left_tilt'), ('left_led', 'right_led'))
    >>> K = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
    >>> down, height = np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 3.0])
    >>> camera = CameraModel(640, 480, K, np.zeros(5), R_cam_base=down, t_cam_base=height)
    >>> camera.project([0.1, 0.0, 1.0]).tolist()
    [349.5, 239.5]
"""
