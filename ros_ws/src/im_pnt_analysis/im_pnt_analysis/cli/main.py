"""``pnt``: verify, simulate, draw and convert net files."""

import argparse
import sys
from collections.abc import Sequence

from im_core.errors import ImError
from im_pnt.cli import bench, convert, draw, schema, simulate, time, verify
from im_pnt.cli.exits import BAD_INPUT, OK, REFUSED

_DESCRIPTION = """Works on Petri net transducers: YAML files with places, transitions, tapes, guards and actions, or
PNML files of other tools. docs/nets.md tells how to write one.

  pnt verify dispatcher.yaml motion_coordinator.yaml   may these nets run together?
  pnt simulate dispatcher.yaml --seed 7 --steps 50     plays a net with imagined actions
  pnt time dispatcher.yaml --command calibrate_camera  how long a command takes, and why
  pnt draw dispatcher.yaml -o dispatcher.svg           draws it (.svg or .dot)
  pnt convert dispatcher.yaml dispatcher.pnml          writes it for other tools, or reads theirs
  pnt schema > net.schema.json                         what editors complete and explain net files with
  pnt bench dispatcher.yaml                            how fast it fires and is searched

Exit code: 0 done or verified, 1 the net is refused, 2 a file or an option is wrong."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs ``pnt``.

    Args:
        arguments: Command line without the program's name; None: that of the process.

    Returns:
        Exit code.
    """
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("pnt", description=_DESCRIPTION, formatter_class=raw)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for command in (verify, simulate, time, draw, convert, schema, bench):
        command.add(commands)
    options = parser.parse_args(arguments)
    try:
        return int(options.run(options))
    except ImError as error:
        print(f"pnt: {error}", file=sys.stderr)
        return REFUSED if error.code == "net_refused" else BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()
        return OK
