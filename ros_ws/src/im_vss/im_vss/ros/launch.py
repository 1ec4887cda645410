"""``vss``: prepare the processes of the frame source before ROS is loaded: cameras must have no ROS."""

import sys
from contextlib import suppress

from im_cell.frames import FrameSource
from im_cell.robot import load_cell
from im_core import plugins
from im_core.errors import ConfigError
from im_vss.settings import load_settings


def main() -> int:
    """Run the node ``/vss``."""
    with suppress(ConfigError):  # the node says what is wrong, if it is to use it
        entry = load_settings(load_cell()).frame_source
        plugins.load(entry.implementation, FrameSource, "frame source").prepare()
    from im_vss.ros.node import main as run

    return run()


if __name__ == "__main__":
    sys.exit(main())
