"""What the files of a calibration took is given back, whichever threads have written them."""

import json
import os
import subprocess
import sys

#: Writes a calibration in each of several threads, one after another, which then stay; a thread that lives keeps its
#: arena. Prints what the process has in use after each [MiB].
PROGRAM = """
import json, sys, threading
from pathlib import Path
from types import SimpleNamespace

from bench.calibration.synthetic import Design, make_scene
from im_calibration import calibrate
from im_vss.services.calibrate import write_calibration

problem = make_scene(Design(), 1).problem
calibration = calibrate(problem)
unmoved = SimpleNamespace(rectified=lambda mounted: None)
stay = threading.Event()
after = []

def write(written):
    write_calibration(Path(sys.argv[1]), calibration, problem, unmoved, {}, calibration.camera_covariance)
    written.set()
    stay.wait()

for _ in range(5):
    written = threading.Event()
    threading.Thread(target=write, args=(written,)).start()
    written.wait()
    with open("/proc/self/smaps_rollup") as file:
        after.append(next(int(line.split()[1]) / 1024 for line in file if line.startswith("Anonymous:")))
stay.set()
print(json.dumps(after))
"""


def test_threads_that_write_calibrations_leave_little_behind(tmp_path):
    argv = (sys.executable, "-c", PROGRAM, str(tmp_path))
    many = {name: value for name, value in os.environ.items() if name != "MALLOC_ARENA_MAX"}
    after = json.loads(subprocess.run(argv, env=many, capture_output=True, check=True).stdout)
    loaded = after[0]  # with all libraries, and one arena
    assert after[-1] - loaded < loaded / 7
