"""``testbed``: before it loads ROS, of which the physics must have nothing, a copy of it loads the physics."""

import sys

from im_core.process import prepare


def main() -> int:
    """Run the node ``/testbed``."""
    prepare("im_sim.physics")
    from im_sim.ros.node import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
