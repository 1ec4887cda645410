"""``pnt``: verify, simulate, time and convert net files, look into journals, and commands of other packages."""

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from importlib import import_module

from im_bag.command_line import parsed
from im_core.errors import ImError
from im_core.options import NumberParser
from im_core.plugins import extensions
from im_pnt_analysis.cli.terminal import BAD_INPUT, INTERRUPTED, OK, REFUSED

_DESCRIPTION = """Works on Petri net transducers: YAML files with places, transitions, tapes, guards and actions, or
PNML files of other tools. docs/nets.md tells how to write one.

  scripts/im pnt verify dispatcher.yaml motion_coordinator.yaml   may these nets run together?
  scripts/im pnt run pick.yaml --symbol pick                      runs a net in a node of its own, on any robot
  scripts/im pnt test my_nets                                     runs scenarios: mocked answers, expectations
  scripts/im pnt simulate dispatcher.yaml --seed 7 --steps 50     plays a net with imagined actions
  scripts/im pnt time dispatcher.yaml --command calibrate_camera  how long a command takes, and why{draw}
  scripts/im pnt policy pick.yaml --command pick                  which of several ways to take, and when
  scripts/im pnt convert dispatcher.yaml dispatcher.pnml          writes it for other tools, or reads theirs
  scripts/im pnt schema > net.schema.json                         what editors complete and explain net files with
  scripts/im pnt journal show dispatcher                          what a node would remember if it came back
  scripts/im pnt bag bags/demo --picture mission.svg              what a recording tells: time line, gaps, durations
  scripts/im pnt fit bags/demo --nets pick.yaml --write           delays and probabilities of nets out of recordings
  scripts/im pnt mission bags/demo                                do its nets still do the same?

Exit code: 0 done or verified, 1 the net is refused, 2 a file or an option is wrong, 130 interrupted
(verify: 3 it is not proved)."""
_DRAW = """
  scripts/im pnt draw dispatcher.yaml -o dispatcher.svg           draws it (.svg or .dot)
  scripts/im pnt display bags/demo                                the nets over a recording, on a web page"""

_COMMANDS = {
    "verify": "check whether nets may run",
    "simulate": "play a net",
    "time": "compute how fast a net is",
    "policy": "compute the best choices of a net",
    "convert": "convert YAML to PNML and back",
    "schema": "print the JSON schema",
    "bag": "show the firings of a recording",
    "fit": "take times and probabilities from recordings",
}
"""Modules of this folder; only the one that is called is imported, which no other has to wait for."""

_ELSEWHERE = {
    "display": "im_pnt_display",
    "draw": "im_pnt_display",
    "journal": "im_pnt_node",
    "mission": "im_pnt_node",
    "run": "im_pnt_node",
    "test": "im_pnt_node",
}
"""Commands of packages above this one, which name themselves as entry points."""

_PROGRAMS = {"run": "run nets", "mission": "run the nets of a recording again"}
"""Those of them with a command line of their own."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``pnt``.

    Args:
        arguments: Command line without the program's name; None: that of the process.

    Returns:
        Exit code.
    """
    words = sys.argv[1:] if arguments is None else arguments
    raw = argparse.RawDescriptionHelpFormatter
    parser = NumberParser(prog="im pnt", formatter_class=raw)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    if words[:1] and words[0] in _PROGRAMS:
        try:
            program = next(extensions("im_pnt.programs", words[0]), None)
        except ModuleNotFoundError as error:
            print(f"pnt: {words[0]} needs ROS, which was not sourced ({error.name} is not found)", file=sys.stderr)
            return BAD_INPUT
        return _not_installed(words[0]) if program is None else int(program(words[1:], f"im pnt {words[0]}"))
    called = next((word for word in words if not word.startswith("-")), "")
    for name, text in _COMMANDS.items():
        command = commands.add_parser(name, help=text, formatter_class=raw)
        if name == called:
            import_module(f"im_pnt_analysis.cli.{name}").configure(command)
    if called not in _COMMANDS:
        for add in extensions("im_pnt.commands"):
            add(commands)
        for name, text in _PROGRAMS.items():
            commands.add_parser(name, help=text)
        if called in _ELSEWHERE and called not in commands.choices:
            return _not_installed(called)
    parser.description = _DESCRIPTION.format(draw=_DRAW if "draw" in commands.choices else "")
    options = parsed(parser, words)
    try:
        code = int(options.run(options))
        if sys.stdout is not None:  # it was not closed when the program began
            sys.stdout.flush()  # whether all could be said is known now
    except ImError as error:
        print(f"pnt: {error}", file=sys.stderr)
        return REFUSED if error.code == "net_refused" else BAD_INPUT
    except BrokenPipeError:
        sys.stderr.close()
        return OK
    except OSError as error:
        print(f"pnt: {error}", file=sys.stderr)
        _give_up_output()
        return BAD_INPUT
    except KeyboardInterrupt:
        print("\npnt: interrupted", file=sys.stderr)
        return INTERRUPTED
    return code


def _not_installed(command: str) -> int:
    package = _ELSEWHERE[command]
    print(f"pnt: {command} is a command of the package {package}, which is not installed", file=sys.stderr)
    return BAD_INPUT


def _give_up_output() -> None:
    """Silence the interpreter at the end: the output has no room."""
    if sys.__stdout__ is not None and sys.stdout is sys.__stdout__:
        with suppress(OSError):
            sys.stdout.close()
