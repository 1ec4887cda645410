"""``im load`` and ``im unload``: nets of the running dispatcher."""

import argparse
from pathlib import Path

from im import Machine, MachineError
from im_bringup.ros.client_output import DONE, FAILED
from im_bringup.ros.run_command import talk
from im_core.errors import ImError
from im_core.files import read_text
from im_core.output import complain

_CODES = "Exit codes: 0 done, 1 refused, 2 bad usage, 3 the machine does not run, 130 interrupted."


def load() -> int:
    """Run ``im load``."""
    parser = _parser(
        "load",
        "Give the dispatcher a net: verified, then live; a refusal prints why. Running commands end in the former one.",
    )
    parser.add_argument("net", type=Path, metavar="NET.yaml", help="file of the net; those that it includes go with it")
    options = parser.parse_args()

    def use(machine: Machine) -> int:
        try:
            print(machine.load_net(options.net, options.wait))
        except MachineError as error:
            complain(f"im load: {error.message}")
            match error.facts:
                case {"counterexample": list(steps)}:
                    for step in steps:
                        complain(f"  {step}")
            return FAILED
        return DONE

    try:
        read_text(options.net)
    except ImError as error:
        parser.error(error.message)
    return talk(use, "im load")


def unload() -> int:
    """Run ``im unload``."""
    parser = _parser("unload", "Take a net and its commands out of the dispatcher, once the net is at rest.")
    parser.add_argument("net", metavar="NET", help="name of the net")
    options = parser.parse_args()

    def use(machine: Machine) -> int:
        machine.unload_net(options.net, options.wait)
        print(f"net {options.net} is gone")
        return DONE

    return talk(use, "im unload")


def _parser(name: str, description: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=f"im {name}", description=description, epilog=_CODES)
    parser.add_argument(
        "--wait", type=float, default=0.0, metavar="S", help="longest wait for the present net to rest [s] (default: 0)"
    )
    return parser
