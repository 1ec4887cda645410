"""``python -m im_sim.cameras``: the camera process, started by :class:`im_sim.cameras.host.CameraHost`."""

import argparse
import sys
from pathlib import Path

from im_core.config import parse_model
from im_core.errors import ImError
from im_sim.cameras.process import run
from im_sim.cameras.protocol import CameraSettings


def main() -> int:
    """Run the camera process; exit code 1 with one sentence if unable to start."""
    parser = argparse.ArgumentParser(prog="im_sim.cameras", description=__doc__)
    parser.add_argument("--instance", required=True, help="prefix of the machine's shared memory, e.g. im0")
    parser.add_argument("--truth", type=Path, required=True, help="the testbed's truth.json")
    parser.add_argument("--settings", required=True, help="cameras in use, sensor and renderer, as JSON")
    arguments = parser.parse_args()
    try:
        settings = parse_model(arguments.settings, CameraSettings, "--settings")
        run(arguments.instance, arguments.truth, settings)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
