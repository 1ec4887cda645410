"""``testbed``: load the physics in a copy of the process, before ROS is loaded: physics must have no ROS."""

import sys

from im_core.processes.process import prepare


def main() -> int:
    """Run the node ``/testbed``."""
    prepare("im_sim.physics")
    from im_sim.ros.node import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
