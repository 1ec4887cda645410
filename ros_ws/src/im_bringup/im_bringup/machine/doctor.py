"""``doctor``: make all checks of a start without starting, and print each fault with its remedy."""

import argparse
import sys

from im_bringup.machine import preflight
from im_core.output import say


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="im doctor",
        description="Check whether a machine can start in this environment; print each fault with its remedy.",
        epilog="Exit codes: 0 it can, 1 there is a fault, 2 bad usage.",
    )
    parser.parse_args()
    faults = 0
    for check in preflight.host_checks():
        fault = check.fault()
        faults += fault is not None
        say(f"{check.name}: {'ok' if fault is None else f'FAULT: {fault.message}'}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
