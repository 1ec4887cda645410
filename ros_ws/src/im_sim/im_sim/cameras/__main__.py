"""``python -m im_vss.camera``: the camera process, started by the node ``/vss``."""

import argparse
import sys
from pathlib import Path

from im_core.errors import ImError
from im_vss.camera.process import Options, run


def main() -> int:
    """Run the camera process; exit code 1 with one sentence if it cannot start."""
    parser = argparse.ArgumentParser(prog="im_vss.camera", description=__doc__)
    parser.add_argument("--instance", required=True, help="prefix of the machine's shared memory, e.g. im0")
    parser.add_argument("--truth", type=Path, required=True, help="the testbed's truth.json")
    parser.add_argument("--renderer", choices=("auto", "egl", "tiny"), default="auto")
    parser.add_argument("--settings", type=Path, default=None, help="a vss.yaml; the shipped one by default")
    parser.add_argument("--cell", type=Path, default=None, help="a cell.yaml; the shipped one by default")
    arguments = parser.parse_args()
    try:
        run(Options(arguments.instance, arguments.truth, arguments.renderer), arguments.cell, arguments.settings)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
