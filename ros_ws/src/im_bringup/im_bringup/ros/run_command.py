"""``im run``: runs a command of the Dispatcher with progress, lists available and running commands.

A dispatcher that dies and is started again goes on with its commands; this client then attaches to its own by number.
"""

import argparse
import contextlib
import json
import re
import select
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO
from uuid import uuid4

from rclpy.action import ActionClient
from rclpy.task import Future
from std_msgs.msg import String
from unique_identifier_msgs.msg import UUID

from im_bringup.calibration.summary import summary
from im_bringup.command_line import CommandParser, command_told, completions
from im_bringup.ros.dispatcher import (
    ACCEPT_S,
    ACTION,
    DISCOVERY_S,
    GOES_ON,
    SILENCE_S,
    DispatcherClient,
)
from im_bringup.ros.interruptible import DONE, FAILED, INTERRUPTED, USAGE, talk
from im_core.bounded_json import read_json
from im_core.errors import ArgumentError, NotFoundError, StateError, StoreError, WaitTimeoutError, require_text
from im_core.files import FileError, write_whole
from im_core.message_paths import hand_over
from im_core.names import run_dir
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient
from im_core.ros.servers import reason
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState
from im_msgs.srv import ControlCommand

LIST = "/dispatcher/commands"
CONTROLS = ("cancel", "pause", "resume")
ASKED_S = 0.05
"""How often is looked whether a question was answered [s]."""
MOST_NUMBER = 2**32 - 1
#: Of results that a person is shown: a report of a calibration has 280,000 characters.
MOST_SHOWN = 1000


class CommandClient(DispatcherClient):
    """Client to run commands and report progress."""

    def __init__(self) -> None:
        super().__init__("run")
        self._progress: TextIO = sys.stdout
        self._told: list[dict[str, Any]] | None = None
        self._number = 0
        self._cancelling = False
        self._line = ""
        self._execute: ActionClient = GuardedActionClient(self, ExecuteCommand, ACTION)
        self._control = self.create_client(ControlCommand, "/dispatcher/control_command")
        self.create_subscription(String, LIST, self._learn, qos.LATCHED)

    @property
    def begun(self) -> bool:
        """Whether the command of :meth:`run` was written down, and so has a number."""
        return bool(self._number)

    def commands(self) -> Sequence[Mapping[str, Any]]:
        """Return the Dispatcher's descriptions of all commands.

        Raises:
            WaitTimeoutError: It tells nothing.
        """
        self._until(lambda: self._dispatcher_there() and self._told is not None, f"the topic {LIST}")
        assert self._told is not None
        with contextlib.suppress(StoreError):  # a shell then completes no names
            write_whole(run_dir() / "commands.txt", completions(self._told))
        return self._told

    def under_way(self) -> Sequence[CommandState]:
        """Return the commands still running."""
        return list(self.listed().commands)

    def control(self, number: int, request: str) -> str:
        """Cancel, pause or resume a command; return the change made.

        Raises:
            StateError: It was not.
        """
        answer = self._asked(self._control, ControlCommand.Request(command_id=number, request=request))
        if not answer.success:
            raise StateError(reason(self, str(answer.message), self._control.srv_name))
        return str(answer.message)

    def run(self, goal: ExecuteCommand.Goal, progress: TextIO) -> Any:
        """Run a command, or attach to one, and wait for the end; an interruption cancels the command.

        Args:
            goal: The command.
            progress: Where its progress is told.

        Raises:
            KeyboardInterrupt: It was interrupted for the second time, or before the command was written down.
            LinkError: The dispatcher fell silent.
            StateError: It died before it had written the command down, or which one it is is not known.
        """
        self._number, self._progress = int(goal.command_id), progress
        before = None if self._number else self.moment()
        handle = self._sent(goal)
        while True:
            result = None if handle is None else self._ended(handle)
            if result is not None:
                return result
            if before is not None and not self._number:
                self._number = self.begun_since(before, goal.symbol)
            print(f"im run: the dispatcher died and is back; attaching to number {self._number}", file=sys.stderr)
            # in a new mission the number may be that of another command
            again = ExecuteCommand.Goal(attach=True, command_id=self._number, symbol=goal.symbol)
            handle = self._sent(again, SILENCE_S)

    def _sent(self, goal: ExecuteCommand.Goal, seconds: float = DISCOVERY_S) -> Any | None:
        def there() -> bool:
            return self._dispatcher_there() and self._execute.server_is_ready()

        self._until(there, f"the action {ACTION}", seconds)
        goal_id, known, answered = UUID(uuid=list(uuid4().bytes)), self._incarnation, Future()

        def answer(sent: Future) -> None:
            if not answered.done():
                answered.set_result(sent.result())

        while self._incarnation == known and not answered.done():  # whoever has the goal takes it no second time
            sent = self._execute.send_goal_async(goal, feedback_callback=self._show, goal_uuid=goal_id)
            sent.add_done_callback(answer)
            self._answer(answered, ACCEPT_S)
        return answered.result() if answered.done() else None

    def _ended(self, handle: Any) -> Any | None:
        future = handle.get_result_async()
        try:
            if self._cancelling:  # a former incarnation was asked to, and may have died with that
                handle.cancel_goal_async()
            answer = self._answer(future)
        except KeyboardInterrupt:
            if self._cancelling:
                raise
            print("im run: cancelling the command; interrupt again to leave it alone", file=sys.stderr)
            self._interrupted.clear()
            self._cancelling = True
            handle.cancel_goal_async()
            answer = self._answer(future)
        return self._result(answer)

    def _asked(self, client: Any, request: Any) -> Any:
        self._until(lambda: self._dispatcher_there() and client.service_is_ready(), f"the service {client.srv_name}")
        answer = self._answer(client.call_async(request), SILENCE_S)
        if answer is None:
            raise WaitTimeoutError(what=f"the answer of {client.srv_name}", seconds=SILENCE_S)
        return answer

    def _learn(self, message: String) -> None:
        self._told = read_json(dict[str, list[dict[str, Any]]], message.data, LIST)["commands"]

    def _show(self, message: Any) -> None:
        feedback = message.feedback
        if not self._number:
            self._number = int(feedback.command_id)
            self._tell(f"number {self._number}")
        share = f"[{100 * feedback.progress:3.0f} %] " if feedback.progress > 0 else ""
        state = "" if feedback.state == "running" else f"{feedback.state}: "
        text = feedback.message or feedback.step
        if text or state:
            self._tell(f"{share}{state}{text}".rstrip(": "))

    def _tell(self, line: str) -> None:
        if line != self._line:
            self._line = line
            print(line, file=self._progress, flush=True)


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
    for request in CONTROLS:
        one.add_argument(f"--{request}", type=_command_number, metavar="NUMBER", help=f"{request} a command")
    parser.add_argument("--json", action="store_true", help="with --attach: print its results as JSON")
    texts = sys.argv[1:]
    named = bool(texts) and not texts[0].startswith("-")
    options = parser.parse_args(texts[:1] if named else texts)
    if options.name is not None and not named:
        parser.error(f"the command comes first: im run {options.name} ...; a number stands for one that was begun")
    if options.json and options.attach is None:
        parser.error("--json goes with --attach, or behind the name of a command")
    return talk(CommandClient, lambda client: _do(client, options, texts[1:]), "im run", GOES_ON)


def _command_number(text: str) -> int:
    if not re.fullmatch("[0-9]{1,10}", text) or not 0 < int(text) <= MOST_NUMBER:
        raise argparse.ArgumentTypeError(f"{text[:60]} is no number of a command; im run lists those under way")
    return int(text)


def _do(client: CommandClient, options: argparse.Namespace, texts: Sequence[str]) -> int:
    for request in CONTROLS:
        if (number := getattr(options, request)) is not None:
            print(client.control(number, request))
            return DONE
    if options.attach is not None:
        goal = ExecuteCommand.Goal(attach=True, command_id=options.attach)
        result = client.run(goal, _progress(options))
        return show(result, "im run", options.json, client.begun)
    if options.name is None:
        print_list(client.commands(), client.under_way())
        return DONE
    try:
        command = CommandParser(command_told(client.commands(), options.name))
        arguments, given = command.read(texts)
        text = require_text(json.dumps(handed_over(arguments), allow_nan=False), "the arguments")
    except (NotFoundError, FileError, StoreError) as error:
        print(f"im run: {error.message}", file=sys.stderr)
        return USAGE
    except ValueError as error:
        print(f"im run: {error}", file=sys.stderr)
        return USAGE
    goal = ExecuteCommand.Goal(symbol=options.name, arguments=text, priority=max(-128, min(127, given.priority)))
    result = client.run(goal, _progress(given))
    if not (result.success or client.begun) and (under_way := same_under_way(client, options.name)):
        print(f"im run {options.name}: {result.status.message}", file=sys.stderr)
        if not offered(client, under_way):
            return FAILED
        result = client.run(ExecuteCommand.Goal(attach=True, command_id=under_way.command_id), _progress(given))
    return show(result, f"im run {options.name}", given.json, client.begun)


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


def same_under_way(client: CommandClient, symbol: str) -> CommandState | None:
    """Return the oldest unfinished command of a symbol, None if there is none."""
    return next((state for state in client.under_way() if state.symbol == symbol), None)


def offered(client: CommandClient, state: CommandState) -> bool:
    """Print how to attach to a running command, and ask whether to attach if a person can answer.

    Raises:
        KeyboardInterrupt: Somebody interrupts the question.
    """
    number = state.command_id
    resume = f"; im run --resume {number} goes on with it" if state.state == "paused" else ""
    print(f"number {number} is {state.state}: im run --attach {number} waits for it{resume}", file=sys.stderr)
    if not sys.stdin.isatty():
        return False
    print("attach to it? [y/N] ", end="", file=sys.stderr, flush=True)
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        client.pause(ASKED_S)
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def _progress(options: argparse.Namespace) -> TextIO:
    return sys.stderr if options.json else sys.stdout


def show(result: ExecuteCommand.Result, who: str, as_json: bool, begun: bool) -> int:
    """Print how a command ended; returns the exit code.

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
    report = results["report"]
    print(f"\n{who}: done: {'; but '.join(filter(None, (report['message'], results.get('message'))))}")
    print(summary(report))
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
