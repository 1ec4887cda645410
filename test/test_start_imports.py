"""What a start need not wait for is loaded when it is used first: half of the start was the loading of libraries."""

import subprocess
import sys

import pytest

NODES = (
    "im_coordinators.ros.gripper",
    "im_coordinators.ros.motion",
    "im_coordinators.ros.path_planning",
    "im_coordinators.ros.vision",
    "im_dispatcher.ros.node",
    "im_dom.ros.node",
    "im_mcs.ros.node",
    "im_mcs.servo.process",
    "im_pnt_display.ros.node",
    "im_sim.cameras.process",
    "im_sim.physics",
    "im_sim.ros.node",
    "im_vss.ros.node",
)
PARTS = ("linalg", "ndimage", "optimize", "sparse", "spatial", "special", "stats")
LATER = ("matplotlib", "rosbags", *(f"scipy.{part}" for part in PARTS))
#: The supervisor only waits, all the time that the machine runs.
SUPERVISOR = "im_bringup.machine.supervisor"
#: Its process is copied for those of the tasks, which must be before ROS has made threads in it.
LAUNCH = "im_bringup.ros.launch"
#: All else waits until it has started the bootstrap.
COMMAND = "im_bringup.machine.start"
#: The bootstrap has it tell whether the nets may run together, which mostly was proved before.
VERIFY = "im_pnt_analysis.cli.verify"
#: A client of the machine: a command line waits for it.
CLIENT = "im_bringup.ros.run_command"
USED_TYPE = "import im_core.ros.qos; from std_msgs.msg import String; type(String).__import_type_support__()"
ASKED_TYPE = "from im_pnt.expression.types import installed_types; installed_types().fields('std_msgs/msg/String')"
POSE = "import numpy; from im_vss.ros.messages import to_pose; to_pose(numpy.zeros(3), numpy.eye(3))"


@pytest.mark.parametrize(
    ("start", "later"),
    [
        (f"import {', '.join(NODES)}", LATER),
        (f"import {SUPERVISOR}", ("numpy", "pydantic", "yaml")),
        (f"import {COMMAND}", ("im_cell", "numpy", "rclpy", "scipy")),
        (f"import {LAUNCH}, importlib; [*map(importlib.import_module, {LAUNCH}.COMMON)]", ("rclpy", *LATER)),
        (f"import {VERIFY}", ("numpy", "im_pnt_analysis.search.reachability")),
        (f"import {CLIENT}", ("asyncio", "pydantic", "im_core.ros.guard")),
        (USED_TYPE, ("em", "lark")),
        (ASKED_TYPE, ("rclpy", "im_pnt_node.rerun.log")),
        ("import im_coordinators.ros.gripper", ("im_mcs", "im_coordinators.path_search")),
        (POSE, LATER),  # each camera's pose, before the machine is ready
    ],
    ids=["nodes", "supervisor", "command", "launch", "verify", "client", "type of ROS", "proof", "gripper", "poses"],
)
def test_nothing_is_loaded_at_the_start_that_is_used_later(start, later):
    code = f"import sys; {start}; print(*(name for name in {later} if name in sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == ""
