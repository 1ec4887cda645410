"""``doctor``: make all checks of a start without starting, and print each fault with its remedy."""

import argparse
import sys
from pathlib import Path

from im_bringup.machine import machine_state as machine
from im_bringup.machine import preflight
from im_bringup.tasks import deployment as deployments
from im_core.errors import ImError
from im_core.output import complain, say


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="im doctor",
        description="Check whether a machine can start in this environment; print each fault with its remedy.",
        epilog="Exit codes: 0 it can, 1 there is a fault, 2 bad usage or deployment file.",
    )
    parser.add_argument("deployment", nargs="?", help="deployment file (default: the one of im_bringup)")
    path = Path(parser.parse_args().deployment or deployments.default_path())
    checks = preflight.host_checks()
    try:
        record = machine.read()
        if record is not None and record.alive:
            say(f"machine: {record.state} in ROS domain {machine.domain()}, with its part of the shared memory")
        else:
            checks.append(preflight.shared_memory_check(deployments.load(path)))
    except ImError as error:
        complain(f"im doctor: {error.message}")
        return 2
    faults = 0
    for check in checks:
        fault = check.fault()
        faults += fault is not None
        say(f"{check.name}: {'ok' if fault is None else f'FAULT: {fault.message}'}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
