"""``shared_process PACKAGE/EXECUTABLE ...``: the nodes of several executables in one process.

A deployment starts it for a process that has several tasks. The executables are those that would run alone: each is
run up to where it would spin its node. They share the interpreter, the DDS participant and the loop: what blocks the
loop blocks all of them, and what ends the process ends them together.
"""

import argparse
import runpy
import sys
from collections.abc import Sequence
from pathlib import Path

from rclpy.utilities import remove_ros_args

from im_core.errors import ConfigError, ImError
from im_core.executables import path_of
from im_core.ros import run
from im_core.ros.run import Program


def programs_of(executables: Sequence[str]) -> list[Program]:
    """Return the program of each executable.

    Args:
        executables: Package and executable of each, ``package/executable``.

    Raises:
        NotFoundError: There is no such package or executable.
        ConfigError: One does not run exactly one node, by :func:`im_core.ros.run.main`.
    """
    with run.gathered() as programs:
        for number, name in enumerate(executables, start=1):
            package, _, executable = name.partition("/")
            _execute(path_of(package, executable))
            if len(programs) != number:
                raise ConfigError(
                    f"{name} cannot share a process: it runs {len(programs) - number + 1} nodes by "
                    "im_core.ros.run.main, it must run 1"
                )
    return programs


def _execute(program: Path) -> None:
    mine, sys.argv = sys.argv, [str(program)]
    try:
        runpy.run_path(str(program), run_name="__main__")
    except SystemExit:  # with what main returns
        pass
    except (SyntaxError, ValueError) as error:
        raise ConfigError(f"{program} cannot share a process: it is no Python program ({error})") from error
    finally:
        sys.argv = mine


def main() -> int:
    """Run the nodes until SIGINT or SIGTERM."""
    parser = argparse.ArgumentParser(prog="shared_process", description="Run the nodes of several executables.")
    parser.add_argument("executables", nargs="+", metavar="PACKAGE/EXECUTABLE", help="executable of a node")
    try:
        programs = programs_of(parser.parse_args(remove_ros_args(sys.argv)[1:]).executables)
    except ImError as error:
        print(error.message, file=sys.stderr)
        return 1
    return run.run_together(programs)


if __name__ == "__main__":
    sys.exit(main())
