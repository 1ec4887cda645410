"""What a start need not wait for is loaded when it is used first: half of the start was the loading of libraries."""

import subprocess
import sys

NODES = (
    "im_coordinators.ros.gripper",
    "im_coordinators.ros.motion",
    "im_coordinators.ros.path_planning",
    "im_coordinators.ros.vision",
    "im_dispatcher.ros.node",
    "im_dom.ros.node",
    "im_mcs.ros.node",
    "im_pnt_display.ros.node",
    "im_sim.cameras.process",
    "im_sim.ros.node",
    "im_vss.ros.node",
)
PARTS = ("linalg", "ndimage", "optimize", "sparse", "spatial", "stats")
LATER = ("matplotlib", *(f"scipy.{part}" for part in PARTS))


def test_no_node_loads_at_its_start_what_it_uses_later():
    code = f"import sys, {', '.join(NODES)}\nprint(*(name for name in {LATER} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == ""
