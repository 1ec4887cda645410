"""``mcs``: load the servo in a copy of the process, before ROS is loaded: the servo must have no ROS."""

import sys
from contextlib import suppress

from im_core.errors import ConfigError
from im_core.processes.process import prepare
from im_mcs.limits.configuration import load_config


def main() -> int:
    """Run the node ``/mcs``."""
    with suppress(ConfigError):  # servo and node say what is wrong with it, if they are to use it
        load_config()
    prepare("im_mcs.servo")
    from im_mcs.ros.node import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
