"""``im run``: runs a command of the Dispatcher with progress, lists available and running commands.

A dispatcher that dies and is started again goes on with its commands; this client then attaches to its own by number.
"""

import argparse
import contextlib
import json
import re
import select
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from im import Command, Machine, UnreachableError
from im.commands import DISPATCHER
from im_bringup.command_line import CommandParser, command_told, completions
from im_bringup.machine import machine_state
from im_bringup.machine.interrupts import ignore_interrupts, interrupt_once
from im_bringup.ros.client_output import (
    DONE,
    FAILED,
    INTERRUPTED,
    LOOKED_FOR_S,
    NOT_RUNNING,
    USAGE,
    exit_code,
    own_output,
)
from im_core import plugins
from im_core.errors import ArgumentError, ImError, NotFoundError, StateError, StoreError, require_text
from im_core.files import FileError, write_whole
from im_core.message_paths import hand_over
from im_core.names import run_dir
from im_core.options import shown
from im_core.output import complain
from im_core.ros.peers.servers import reason
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState, Status

CONTROLS = {
    "cancel": "have a command end early",
    "pause": "let what runs of a command end, and begin nothing more",
    "resume": "go on with a paused command",
    "abandon": "last resort: end a command at once though a cancellation changes nothing; says what it held",
}
MOST_NUMBER = 2**32 - 1
#: Of results that a person is shown: a report of a calibration has 280,000 characters.
MOST_SHOWN = 1000
#: How long a silent dispatcher is waited for [s]: one that died is started again in a few seconds, or later.
SILENCE_S = 60.0
#: So long after a signal to end [s] another one is the same: a terminal tells a script and its client, and the script
#: tells the client again.
_ONE_INTERRUPT_S = 0.5
#: Reads the commands of a deployment from their net files, where no machine tells them.
_READER = "im_dispatcher.commands:describe_named"


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(
        prog="im run",
        description="Run a command of the machine, or list the commands. im run NAME --help shows its arguments.",
        epilog="Ctrl-C cancels the command. Exit codes: 0 done, 1 failed or refused, 2 bad usage, 3 the machine does "
        "not run, 130 interrupted.",
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="command to run (default: list all)")
    one = parser.add_mutually_exclusive_group()
    one.add_argument("--attach", type=_command_number, metavar="NUMBER", help="wait for a command that is under way")
    for request, does in CONTROLS.items():
        one.add_argument(f"--{request}", type=_command_number, metavar="NUMBER", help=does)
    parser.add_argument("--yes", action="store_true", help="with --abandon: ask for no confirmation")
    parser.add_argument("--json", action="store_true", help="with --attach: print its results as JSON")
    texts = sys.argv[1:]
    named = bool(texts) and not texts[0].startswith("-")
    options = parser.parse_args(texts[:1] if named else texts)
    if options.name is not None and not named:
        parser.error(f"the command comes first: im run {options.name} ...; a number stands for one that was begun")
    if options.json and options.attach is None:
        parser.error("--json goes with --attach, or behind the name of a command")
    if options.yes and options.abandon is None:
        parser.error("--yes goes with --abandon")
    if options.abandon is not None and not options.yes and not sys.stdin.isatty():
        parser.error(f"--abandon {options.abandon} needs a confirmation: a terminal to ask on, or --yes")
    if named and {"-h", "--help"} & set(texts[1:]) and (told := described_in_files(texts[0])):
        CommandParser(told).read(["--help"])
    return talk(lambda machine: _do(machine, options, texts[1:]), "im run", "; the machine goes on with the command")


def described_in_files(name: str) -> Mapping[str, Any] | None:
    """Return the description of a command of the default deployment; None if a machine runs here, or there is none."""
    from im_bringup.tasks import deployment  # no other use of the command reads a deployment

    with contextlib.suppress(ImError):
        if not machine_state.runs_here():
            described: Any = plugins.make(
                _READER, "list of commands", deployment.load(deployment.default_path()).commands
            )
            return command_told(described["commands"], name)
    return None


def talk(use: Callable[[Machine], int], who: str, goes_on: str = "") -> int:
    """Connect to the machine; print the reason of a failure in one sentence; return the exit code.

    Args:
        use: Uses the machine; returns the exit code.
        who: Name of the program, for messages.
        goes_on: What goes on after an interruption, a sentence's second half.
    """

    def connect() -> int:
        with own_output():
            interrupt_once()
            watch = why_lost if machine_state.recorded() else None
            try:
                machine = Machine.connect(timeout=LOOKED_FOR_S, watch=watch)
            except UnreachableError as error:
                complain(f"{who}: {error.message}")
                return NOT_RUNNING
            with contextlib.closing(machine):
                try:
                    return use(machine)
                finally:
                    ignore_interrupts()

    return exit_code(connect, who, goes_on)


def why_lost(silent_s: float) -> str:
    """Return why a dispatcher silent for a given time will not answer, as a clause; empty if an answer may come."""
    record = machine_state.read()
    if record is None or not record.alive:
        return ": the machine has ended, its bootstrap is gone"
    if silent_s <= SILENCE_S or record.state == machine_state.STARTING:
        return ""
    known = next((each for each in record.missing if each.startswith(f"{DISPATCHER} ")), "")
    return f"; the machine is {record.state}{f', but {known}' if known else ''}"


def _command_number(text: str) -> int:
    if not re.fullmatch("[0-9]{1,10}", text) or not 0 < int(text) <= MOST_NUMBER:
        raise argparse.ArgumentTypeError(f"{shown(text)} is no number of a command; im run lists those under way")
    return int(text)


def _do(machine: Machine, options: argparse.Namespace, texts: Sequence[str]) -> int:
    for request in CONTROLS:
        if (number := getattr(options, request)) is not None:
            if request == "abandon" and not options.yes and not _confirmed(machine, number):
                return FAILED
            print(machine.control(number, request))
            return DONE
    if options.attach is not None:
        return ended(machine, machine.attach(options.attach), "im run", options.json)
    known = machine.commands
    commands = list(known.values())
    with contextlib.suppress(StoreError):  # a shell then completes no names
        write_whole(run_dir() / "commands.txt", completions(commands))
    if options.name is None:
        print_list(commands, states := machine.under_way)
        with contextlib.suppress(StoreError):
            write_whole(run_dir() / "numbers.txt", "".join(f"{state.command_id}\n" for state in states))
        return DONE
    try:
        parser = CommandParser(command_told(commands, options.name, {} if options.name in known else machine.left_out))
        arguments, given = parser.read(texts)
        require_text(json.dumps(taken := handed_over(arguments), allow_nan=False), "the arguments")
    except (NotFoundError, StateError, FileError, StoreError) as error:
        print(f"im run: {error.message}", file=sys.stderr)
        return USAGE
    except ValueError as error:
        print(f"im run: {error}", file=sys.stderr)
        return USAGE
    command = machine.run(options.name, wait=False, priority=given.priority, **taken)
    who = f"im run {options.name}"
    follow(command, given.json)
    if under_way := None if command.begun else same_under_way(machine.under_way, options.name, command.outcome.status):
        print(f"{who}: {command.outcome.status.message}", file=sys.stderr)
        if not offered(under_way):
            return FAILED
        command = machine.attach(under_way.command_id)
    return ended(machine, command, who, given.json)


def ended(machine: Machine, command: Command, who: str, as_json: bool) -> int:
    """Follow a command, and print how it ended; return the exit code."""
    follow(command, as_json)
    result = command.outcome
    if not result.success:
        result.status.message = reason(machine.connection.node, result.status.message, "/dispatcher/execute")
    return show(result, who, as_json, command.begun)


def follow(command: Command, as_json: bool) -> None:
    """Print the progress of a command until its end; an interruption cancels the command.

    Args:
        command: The command.
        as_json: Whether standard output is for the results.

    Raises:
        KeyboardInterrupt: It was interrupted for the second time, or before the command was written down.
    """
    out, last, numbered = sys.stderr if as_json else sys.stdout, "", command.attached
    while not command.ended:
        try:
            for progress in command.progress():
                if not numbered:
                    numbered = True
                    print(f"number {command.number}", file=out, flush=True)
                if (line := str(progress)) and line != last:
                    last = line
                    print(line, file=out, flush=True)
            command.wait()
        except KeyboardInterrupt:
            if command.cancelling or not command.begun:
                raise
            print("im run: cancelling the command; interrupt again to leave it alone", file=sys.stderr)
            command.cancel()
            command.wait(_ONE_INTERRUPT_S)
            interrupt_once()


def handed_over(arguments: Mapping[str, object]) -> dict[str, object]:
    """Copy the files of ``*_file`` arguments to a folder of the machine, and return the arguments with the copies.

    Raises:
        FileError: A file cannot be read.
        StoreError: A copy cannot be written.
    """
    return {
        name: str(hand_over(Path(value))) if name.endswith("_file") and isinstance(value, str) and value else value
        for name, value in arguments.items()
    }


def same_under_way(under_way: Sequence[CommandState], symbol: str, refusal: Status) -> CommandState | None:
    """Return the oldest unfinished command of a symbol, None if there is none or the refusal is about an argument."""
    same = (state for state in under_way if state.symbol == symbol and refusal.code == StateError.default_code)
    return next(same, None)


def offered(state: CommandState) -> bool:
    """Print how to attach to a running command, and ask whether to attach if a person can answer.

    Raises:
        KeyboardInterrupt: Somebody interrupts the question.
    """
    number = state.command_id
    resume = f"; im run --resume {number} goes on with it" if state.state == "paused" else ""
    print(f"number {number} is {state.state}: im run --attach {number} waits for it{resume}", file=sys.stderr)
    if not sys.stdin.isatty():
        return False
    return _agreed("attach to it?")


def _confirmed(machine: Machine, number: int) -> bool:
    """Print a command and the danger of an abandonment, and ask a person."""
    print_list([], [state for state in machine.under_way if state.command_id == number])
    print("its actions under way are cancelled and not awaited: something may still move", file=sys.stderr)
    return _agreed(f"abandon number {number}?")


def _agreed(question: str) -> bool:
    print(f"{question} [y/N] ", end="", file=sys.stderr, flush=True)
    select.select([sys.stdin], [], [])
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def show(result: ExecuteCommand.Result, who: str, as_json: bool, begun: bool) -> int:
    """Print how a command ended; return the exit code.

    Args:
        result: What the dispatcher says.
        who: Begins what is printed of a failure.
        as_json: Whether the results are printed as JSON.
        begun: Whether the command began; arguments that are refused before are bad usage.
    """
    results = json.loads(result.results or "{}")
    if as_json:
        print(result.results or "{}")
    if not result.success:
        print(f"{who}: {results.get('message', result.status.message)}", file=sys.stderr)
        if result.status.code == ArgumentError.default_code and not begun:
            return USAGE
        return INTERRUPTED if result.status.code == "cancelled" else FAILED
    if result.status.message:
        print(f"{who}: {result.status.message}", file=sys.stderr)
    if not as_json:
        if isinstance(report := results.get("report"), dict) and report.get("cameras"):
            return show_calibration(results, who)
        text = json.dumps(results, ensure_ascii=False)
        if len(text) > MOST_SHOWN:
            text = f"{text[:MOST_SHOWN]}... ({len(text)} characters; --json prints all)"
        print(f"{who}: done: {text}" if results else f"{who}: done")
    return DONE


def show_calibration(results: Mapping[str, Any], who: str) -> int:
    """Print the results of a calibration; return the exit code."""
    from im_cell.calibration_summary import brief_summary  # most commands need no numpy

    report = results["report"]
    print(f"\n{who}: done: {'; but '.join(filter(None, (report['message'], results.get('message'))))}")
    print(brief_summary(report))
    print(f"report and pictures: {results['directory']}")
    return DONE


def print_list(commands: Sequence[Mapping[str, Any]], under_way: Sequence[CommandState]) -> None:
    """Print the available commands, and the running ones."""
    width = max((len(told["symbol"]) for told in commands), default=0)
    for told in commands:
        print(f"{told['symbol']:{width}}  {told['description']}".rstrip())
    for state in under_way:
        share = f" {100 * state.progress:.0f} %" if state.progress >= 0 else ""
        message = f": {state.message}" if state.message else ""
        print(f"number {state.command_id}: {state.symbol} {state.arguments} {state.state}{share}{message}")


if __name__ == "__main__":
    sys.exit(main())
