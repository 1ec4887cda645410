"""``im run``: what it prints and returns of how a command ended."""

import json
import os
from types import SimpleNamespace

import pytest

from im_bringup.ros import run_command
from im_bringup.ros.run_command import show
from im_core.errors import DataError
from im_core.ros.messages.status import to_status
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState, Status
from im_pnt.model.arguments import Argument, ArgumentSchema, ArgumentType

WIDTH = Argument("width", ArgumentType.NUMBER, unit="m", minimum=0.0, maximum=0.08)


@pytest.fixture
def refused():
    """How a command ends whose arguments its schema refuses."""
    with pytest.raises(DataError) as caught:
        ArgumentSchema({"width": WIDTH}).check({"width": 0.5}, "command open_gripper")
    return ExecuteCommand.Result(status=to_status(caught.value))


def test_arguments_that_the_schema_refuses_are_bad_usage(refused, capsys):
    assert show(refused, "im run open_gripper", False, begun=False) == 2
    told = capsys.readouterr().err
    expected = "im run open_gripper: command open_gripper: argument width is 0.5, not a number from 0 to 0.08 [m]\n"
    assert told == expected


def test_a_request_that_a_net_makes_with_such_arguments_is_a_failure_of_the_command(refused):
    assert show(refused, "im run pick", False, begun=True) == 1


@pytest.mark.parametrize(("code", "exit_code"), [("unreachable", 1), ("state", 1), ("cancelled", 130)])
def test_what_the_machine_could_not_do_is_no_bad_usage(code, exit_code):
    result = ExecuteCommand.Result(status=to_status(DataError("why", code=code)))
    assert show(result, "im run move", False, begun=False) == exit_code


def test_results_are_printed_as_they_are_asked_for(capsys):
    result = ExecuteCommand.Result(success=True, results='{"width": 0.02}')
    assert show(result, "im run close_gripper", False, begun=True) == 0
    assert show(result, "im run close_gripper", True, begun=True) == 0
    assert capsys.readouterr().out == 'im run close_gripper: done: {"width": 0.02}\n{"width": 0.02}\n'


def test_of_a_calibration_its_report_is_told_in_short(capsys):
    errors = {"reprojection_px": 0.1, "triangulation_mm": None}
    camera = {"name": "wall", "K": [[900.0, 0, 320.0], [0, 901.0, 240.0]], "D": [0.01], "rms_px": 0.2}
    report = {"message": "fits", "cameras": [camera], "points_used": 14, "points_rejected": [], "chi2_per_dof": 1.0}
    report |= {"led_offset_m": [0.0, 0.0, 0.1], "expected_error": errors}
    results = json.dumps({"report": report, "directory": "/results/1", "message": "the light is on"})
    result = ExecuteCommand.Result(success=True, results=results)
    assert show(result, "im run calibrate_camera", False, begun=True) == 0
    told = capsys.readouterr().out
    assert "im run calibrate_camera: done: fits; but the light is on\n" in told
    assert "wall" in told
    assert "report and pictures: /results/1\n" in told


@pytest.mark.parametrize(("state", "told"), [("running", False), ("paused", True)])
def test_a_command_that_is_under_way_is_offered_to_be_attached_to(state, told, monkeypatch, capsys):
    under_way = CommandState(command_id=7, symbol="calibrate_camera", state=state)
    assert not run_command.offered(under_way), "nobody can answer here"
    said = capsys.readouterr().err
    assert f"number 7 is {state}: im run --attach 7 waits for it" in said
    assert ("im run --resume 7 goes on with it" in said) == told
    for answer, attaches in (("y\n", True), ("\n", False)):
        reading, writing = os.openpty()
        os.write(reading, answer.encode())
        with os.fdopen(writing, "r") as terminal:
            monkeypatch.setattr("sys.stdin", terminal)
            assert run_command.offered(under_way) is attaches
        os.close(reading)


@pytest.mark.parametrize(("code", "offered"), [("state", 7), ("data", None)])
def test_a_wrong_argument_is_no_reason_to_attach_to_a_command_of_that_name(code, offered):
    under_way = [CommandState(command_id=number, symbol=symbol) for number, symbol in ((6, "home"), (7, "move"))]
    found = run_command.same_under_way(under_way, "move", Status(code=code, message="no"))
    assert (found and found.command_id) == offered


@pytest.mark.parametrize(("answer", "abandons"), [("y\n", True), ("\n", False)])
def test_an_abandonment_is_confirmed_on_a_terminal_which_shows_the_command(answer, abandons, monkeypatch, capsys):
    asked = []
    states = [CommandState(command_id=number, symbol="move", state="cancelling", progress=-1.0) for number in (6, 7)]
    machine = SimpleNamespace(under_way=states, control=lambda *request: asked.append(request) or "abandon move")
    options = SimpleNamespace(cancel=None, pause=None, resume=None, abandon=7, yes=False)
    reading, writing = os.openpty()
    os.write(reading, answer.encode())
    with os.fdopen(writing, "r") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        assert run_command._do(machine, options, ()) == (0 if abandons else 1)
    os.close(reading)
    told = capsys.readouterr()
    assert told.out.startswith("number 7: move  cancelling\n")
    assert "something may still move\nabandon number 7? [y/N]" in told.err
    assert asked == ([(7, "abandon")] if abandons else [])


def test_long_results_are_cut_for_people_and_whole_as_json(capsys):
    result = ExecuteCommand.Result(success=True, results=f'{{"report": "{"x" * 5000}"}}')
    assert show(result, "im run", False, begun=True) == 0
    assert capsys.readouterr().out.endswith("xxx... (5014 characters; --json prints all)\n")
    assert show(result, "im run", True, begun=True) == 0
    assert capsys.readouterr().out == f"{result.results}\n"


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        (["--attach", "-5"], "-5 is no number of a command; im run lists those under way"),
        (["--cancel", "99999999999"], "99999999999 is no number of a command"),
        (["--pause", "0"], "0 is no number of a command"),
        (["--resume", "move"], "move is no number of a command"),
        (["--cancel", "3", "--pause", "4"], "--pause: not allowed with argument --cancel"),
        (["--attach", "3", "move"], "the command comes first: im run move ..."),
        (["--json"], "--json goes with --attach"),
        (["--yes"], "--yes goes with --abandon"),
        (["--abandon", "3"], "--abandon 3 needs a confirmation: a terminal to ask on, or --yes"),
    ],
)
def test_what_is_no_number_and_what_contradicts_itself_is_bad_usage(texts, sentence, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["im run", *texts])
    with pytest.raises(SystemExit) as ended:
        run_command.main()
    assert ended.value.code == 2
    assert sentence in capsys.readouterr().err


def test_the_help_of_a_command_is_that_of_its_net_file_where_no_machine_has_run(monkeypatch, capsys):
    monkeypatch.setattr(run_command.machine_state, "read", lambda: None)
    monkeypatch.setattr(run_command, "talk", lambda *_: pytest.fail("a machine is looked for"))
    monkeypatch.setattr("sys.argv", ["im run", "open_gripper", "--help"])
    with pytest.raises(SystemExit, match="0"):
        run_command.main()
    told = capsys.readouterr().out
    assert told.startswith("usage: im run open_gripper")
    assert "--group right|left" in told or "--group left|right" in told
    assert "Needs <group>_gripper" in told


@pytest.mark.parametrize(
    ("missing", "told"),
    [
        ([], "; the machine is ready"),
        (["vss died: it was killed by SIGKILL"], "; the machine is ready"),
        (
            ["dom died: nothing was heard of host far", "dispatcher died: nothing was heard of host far"],
            "; the machine is ready, but dispatcher died: nothing was heard of host far",
        ),
    ],
)
def test_of_a_silent_dispatcher_is_told_what_the_bootstrap_knows(monkeypatch, missing, told):
    record = SimpleNamespace(alive=True, state="ready", missing=missing)
    monkeypatch.setattr(run_command.machine_state, "read", lambda: record)
    assert run_command.why_lost(run_command.SILENCE_S) == ""
    assert run_command.why_lost(run_command.SILENCE_S + 1.0) == told
