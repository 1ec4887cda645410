"""Commands on a command line: options, help and values from what the Dispatcher tells of them."""

import os
import subprocess
from pathlib import Path

import pytest

from im_bringup.command_line import CommandParser, command_told, completions
from im_core.errors import NotFoundError

COMPLETION = Path(__file__).parents[4] / "scripts/im_completion.bash"
MOVE = {
    "symbol": "move",
    "net": "move",
    "description": "Moves an arm.",
    "needs": ["${arguments.group}_arm"],
    "busy": "wait",
    "priority": 0,
    "arguments": {
        "type": "object",
        "properties": {
            "group": {"type": "string", "enum": ["left", "right"], "default": "left", "description": "which arm"},
            "poses_file": {"type": "string"},
            "joints": {
                "type": "array",
                "items": {"type": "number", "minimum": -6.3, "maximum": 6.3},
                "minItems": 9,
                "maxItems": 9,
                "unit": "rad",
            },
            "count": {"type": "integer", "default": 1},
            "slow": {"type": "boolean", "default": False},
        },
        "required": ["poses_file"],
        "additionalProperties": False,
    },
}
GRIP = {"symbol": "grip", "net": "grip", "description": ""}


def test_options_are_values_of_the_types_of_the_schema():
    words = "--group right --poses-file a.yaml --joints -1 2 -0.5 --count 3 --slow true --priority -2"
    arguments, options = CommandParser(MOVE).read(words.split())
    assert arguments == {
        "group": "right",
        "poses_file": "a.yaml",
        "joints": [-1.0, 2.0, -0.5],
        "count": 3,
        "slow": True,
    }
    assert options.priority == -2


def test_small_negative_numbers_are_values():
    words = "--poses-file a --joints -1e-3 0.5 -2."
    assert CommandParser(MOVE).read(words.split())[0]["joints"] == [-0.001, 0.5, -2.0]


def test_what_is_not_given_is_left_to_the_net():
    assert CommandParser(MOVE).read(["--poses_file", "a"])[0] == {"poses_file": "a"}


def test_a_command_without_a_schema_takes_json():
    assert CommandParser(GRIP).read(["--arguments", '{"a": [1]}'])[0] == {"a": [1]}


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--group up --grup left --poses-file a", "there is no --grup (did you mean '--group'?)"),
        ("", "--poses-file"),
        ("--poses-file a --count 1.5", "1.5 is not a whole number"),
        ("--poses-file a --joints one", "one is not a finite number"),
        ("--poses-file a --joints nan", "nan is not a finite number"),
        ("--poses-file a --slow yes", "yes is not true or false"),
    ],
)
def test_a_mistake_is_told_in_one_line_and_is_bad_usage(words, message, capsys):
    with pytest.raises(SystemExit) as ended:
        CommandParser(MOVE).read(words.split())
    told = capsys.readouterr().err
    assert ended.value.code == 2
    assert message in told
    assert told.count("\n") == 1


def test_help_tells_what_the_schema_tells(capsys):
    with pytest.raises(SystemExit):
        CommandParser(MOVE).read(["--help"])
    told = " ".join(capsys.readouterr().out.split())
    joints, needs = "-6.3..6.3 [rad] (9 values)", "Needs <group>_arm; where others hold that, it waits"
    for text in ("Moves an arm.", "left|right", 'which arm (default: "left")', joints, needs):
        assert text in told


def test_a_command_that_there_is_not_is_refused_with_the_nearest():
    with pytest.raises(NotFoundError, match="did you mean 'move'"):
        command_told([MOVE, GRIP], "mve")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["im", "r"], "recover run"),
        (["im", "run", "m"], "move"),
        (["im", "run", "move", "--"], "--group --poses-file --joints --count --slow --priority --json --help"),
        (["im", "run", "move", "--group", ""], "left right"),
        (["im", "run", "move", "--slow", "t"], "true"),
    ],
)
def test_a_shell_completes_commands_options_and_choices(words, found, tmp_path):
    (tmp_path / "commands.txt").write_text(completions([MOVE, GRIP]))
    script = 'source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _im; echo "${COMPREPLY[*]}"'
    done = subprocess.run(
        ["bash", "-c", script, "-", str(COMPLETION), *words],
        env={**os.environ, "IM_RUN_DIR": str(tmp_path)},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == found


def test_names_for_a_shell_to_complete():
    assert completions([MOVE, GRIP]) == (
        "move --group=left=right --poses-file --joints --count --slow=true=false\ngrip\n"
    )
