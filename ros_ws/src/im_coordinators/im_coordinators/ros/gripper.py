"""Node ``/gripper_coordinator``."""

import sys

from im_core.config import package_file
from im_core.ros import run
from im_pnt.ros.node import PntNode
from im_pnt_analysis import verify_to_load


class GripperCoordinator(PntNode):
    """Runs ``nets/gripper_coordinator.yaml``, whose actions are goals of MCS."""

    def __init__(self) -> None:
        nets = [package_file("im_coordinators", "nets/gripper_coordinator.yaml")]
        super().__init__("gripper_coordinator", nets, functions={}, guards={}, verifier=verify_to_load)


def main() -> None:
    """Run ``/gripper_coordinator``."""
    sys.exit(run.main(GripperCoordinator))


if __name__ == "__main__":
    main()
