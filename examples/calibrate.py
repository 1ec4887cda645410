"""Calibrate two cameras with progress, and print the result; Ctrl-C cancels.

An argument names another file of poses, on the host of the machine.
"""

import sys

from im import Machine

with Machine.connect() as im:
    for progress in im.calibrate_camera(["ceiling_left", "ceiling_right"], *sys.argv[1:]):
        print(progress, end="\r")
    calibration = progress.result
    print(f"\n{calibration.message}")
    for name, camera in calibration.cameras.items():
        print(f"{name}: focal length {camera.K[0, 0]:.1f} px, residuals {camera.rms_px:.3f} px")
    print("pictures and camera files:", calibration.directory)
