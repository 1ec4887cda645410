"""Commands on a command line: options, help and values from what the Dispatcher tells of them."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from im_bringup.command_line import CommandParser, command_told, completions
from im_core.errors import NotFoundError, StateError

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


def test_a_number_may_have_its_unit_with_a_prefix():
    properties = {
        "accuracy": {"type": "number", "unit": "m"},
        "force": {"type": "number", "unit": "N"},
        "share": {"type": "number", "unit": ""},
        "position": {"type": "array", "items": {"type": "number"}, "unit": "m"},
    }
    parser = CommandParser({**MOVE, "arguments": {"type": "object", "properties": properties}})
    words = "--accuracy 0.3mm --force 2N --share 0.5 --position 1cm -0.2 5um"
    expected = {"accuracy": 3e-4, "force": 2.0, "share": 0.5, "position": [0.01, -0.2, 5e-6]}
    read = parser.read(words.split())[0]
    assert {name: pytest.approx(value) for name, value in expected.items()} == read
    assert parser.read(["--accuracy", "0.3m"])[0]["accuracy"] == 0.3


@pytest.mark.parametrize("text", ["0.3 inch", "mm", "3N", "0.3kmm"])
def test_another_unit_is_refused(text, capsys):
    properties = {"accuracy": {"type": "number", "unit": "m"}}
    with pytest.raises(SystemExit):
        CommandParser({**MOVE, "arguments": {"type": "object", "properties": properties}}).read(["--accuracy", text])
    assert f"argument --accuracy: {text} is not a finite number [m]; " in capsys.readouterr().err


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
        ("--poses-file a --slow=", "'' is not true or false"),
        ("--poses-file a --count=", "'' is not a whole number"),
        ("--poses-file a --priority 11", "argument --priority: 11 is no whole number from -10 to 10"),
        ("--poses-file a --priority -99", "argument --priority: -99 is no whole number from -10 to 10"),
    ],
)
def test_a_mistake_is_told_in_one_line_and_is_bad_usage(words, message, capsys):
    with pytest.raises(SystemExit) as ended:
        CommandParser(MOVE).read(words.split())
    told = capsys.readouterr().err
    assert ended.value.code == 2
    assert message in told
    assert told.count("\n") == 1


@pytest.mark.parametrize("text", ["[" * 50_000, "9" * 5_000], ids=["deep", "long"])
def test_json_that_cannot_be_read_is_told_in_one_line(text, capsys):
    with pytest.raises(SystemExit):
        CommandParser(GRIP).read(["--arguments", text])
    told = capsys.readouterr().err
    assert "is no JSON" in told
    assert told.count("\n") == 1


def test_help_tells_what_the_schema_tells(capsys):
    with pytest.raises(SystemExit):
        CommandParser(MOVE).read(["--help"])
    told = " ".join(capsys.readouterr().out.split())
    joints, needs = "-6.3..6.3 [rad] (9 values)", "Needs <group>_arm; where others hold that, it waits"
    for text in ("Moves an arm.", "left|right", 'which arm (default: "left")', joints, needs):
        assert text in told


@pytest.fixture
def awkward():
    """A command with arguments of the names that ``im run`` has itself."""
    names = ["priority", "json", "help", "run_json", "arguments", "attach", "name", "h"]
    properties = {name: {"type": "integer"} for name in names}
    return {"symbol": "store", "net": "store", "description": "", "arguments": {"properties": properties}}


def test_a_command_can_be_run_whatever_its_arguments_are_called(awkward):
    names = awkward["arguments"]["properties"]
    words = [word for number, name in enumerate(names) for word in (f"--{name}", str(number))]
    arguments, options = CommandParser(awkward).read([*words, "--run-priority", "3", "--run-run-json"])
    assert arguments == {name: number for number, name in enumerate(names)}
    assert (options.priority, options.json) == (3, True)
    assert CommandParser(awkward).read(["--json", "1"])[1].json is False


@pytest.mark.parametrize("word", ["-h", "--run-help"])
def test_help_tells_what_the_options_of_every_command_are_called_then(word, awkward, capsys):
    with pytest.raises(SystemExit) as ended:
        CommandParser(awkward).read([word])
    assert ended.value.code == 0
    told = " ".join(capsys.readouterr().out.split())
    for text in ("-h, --run-help show", "--run-priority N -10 to 10", "--run-run-json print the results"):
        assert text in told
    assert completions([awkward]).split()[-3:] == ["--run-priority", "--run-run-json", "--run-help"]


def test_a_command_that_there_is_not_is_refused_with_the_nearest():
    with pytest.raises(NotFoundError, match="did you mean 'move'"):
        command_told([MOVE, GRIP], "mve")


def test_a_command_that_the_cell_lacks_parts_for_names_them():
    with pytest.raises(StateError, match="look is left out: it needs 1 of the cameras"):
        command_told([MOVE, GRIP], "look", {"look": "it needs 1 of the cameras of the cell, which has 0"})


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["im", "r"], "recover run"),
        (["im", "run", "m"], "move"),
        (["im", "run", "move", "--"], "--group --poses-file --joints --count --slow --priority --json --help"),
        (["im", "run", "move", "--group", ""], "left right"),
        (["im", "run", "move", "--slow", "t"], "true"),
        (["im", "run", "--cancel", ""], "6 17"),
        (["im", "run", "--abandon", "1"], "17"),
        (["im", "cell", "check", "pu"], "puma_pair"),
        (["im", "dom", "a"], "append"),
        (["im", "dom", "append", ""], ""),
    ],
)
def test_a_shell_completes_commands_options_choices_and_numbers(words, found, tmp_path):
    (tmp_path / "numbers.txt").write_text("6\n17\n")
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


@pytest.mark.parametrize("domain", ["", "7"])
def test_a_shell_that_only_sourced_the_completion_knows_the_machine_of_its_domain(tmp_path, domain):
    scripts, run = tmp_path / "scripts", tmp_path / ".run" / f"im{domain or 0}"
    for folder in (scripts, run):
        folder.mkdir(parents=True)
    shutil.copy(COMPLETION, scripts)
    script = 'source "$1"; COMP_WORDS=(im run "$2"); COMP_CWORD=2; _im; echo "${COMPREPLY[*]}"'
    environment = {"PATH": os.environ["PATH"], **({"ROS_DOMAIN_ID": domain} if domain else {})}

    def completed(word):
        argv = ["bash", "-c", script, "-", str(scripts / COMPLETION.name), word]
        return subprocess.run(argv, env=environment, capture_output=True, text=True, check=True)

    before = completed("--a")
    assert (before.stdout, before.stderr) == ("--attach --abandon\n", "")
    (run / "commands.txt").write_text(completions([MOVE, GRIP]))
    assert completed("m").stdout == "move\n"


def test_a_shell_completes_files_where_it_knows_no_names():
    done = subprocess.run(
        ["bash", "-c", 'source "$1"; complete -p im', "-", str(COMPLETION)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "complete -o default -F _im im\n"


def test_names_for_a_shell_to_complete():
    assert completions([MOVE, GRIP]) == (
        "move --group=left=right --poses-file --joints --count --slow=true=false --priority --json --help\n"
        "grip --priority --json --help\n"
    )
