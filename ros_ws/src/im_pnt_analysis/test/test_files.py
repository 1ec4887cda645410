"""What the files alone tell is told before anything runs."""

import sys

import pytest

from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK
from im_pnt_analysis.verify.files import check_files
from im_pnt_analysis.verify.report import readable
from im_pnt_analysis.verify.verdict import verify

NET = """net: n
places: {a: 1}
commands: {go: {needs: ["${arguments.side}_arm"], arguments: {side: {type: string, choices: [left]}}}}
transitions:
  go: {symbol: go, in: a, out: a, emit: go_done}
"""
CELL = ("left_arm", "right_arm")


def told(text, resources=CELL, **more):
    return check_files([parse_net(text), *(parse_net(other) for other in more.values())], resources)


def test_a_net_without_faults_is_told_nothing_of():
    assert told(NET) == []
    assert told(NET, resources=()) == []


@pytest.mark.parametrize(
    ("find", "replacement", "complaint"),
    [
        ("emit: go_done", "emit: goo_done", r":5: transitions\.go: command go never ends .*goo_done is of no command"),
        (", emit: go_done", "", "command go never ends well: no transition emits go_done$"),
        (", emit: go_done", ", emit: go_failed", "command go never ends well: no transition emits go_done$"),
        ("}_arm", "}_armm", r":5: .* needs 'left_armm', which no cell has .*did you mean 'left_arm'"),
        ("in: a,", "in: a, guard: no_such:guard,", r"guard function 'no_such:guard' cannot be loaded: No module"),
        ("in: a,", "in: a, action: json:nothing, on_failure: a,", r":5: .*action function 'json:nothing' cannot be"),
    ],
)
def test_a_fault_of_the_files_is_named(find, replacement, complaint):
    with pytest.raises(NetFileError, match=complaint):
        told(NET.replace(find, replacement))


def test_a_symbol_without_a_declaration_is_told_of():
    net = "net: n\nplaces: {a: 1}\ntransitions: {go: {symbol: go, in: a, out: a}}"
    assert told(net) == ["command go never ends well: no transition emits go_done"]
    other = "net: m\nplaces: {b: {remote: true}}\ntransitions: {end: {in: b, emit: go_done}}"
    assert told(net, other=other) == []
    word = net.replace("symbol: go", "symbol: {name: go, of: command}")
    assert told(word) == []


def test_a_command_whose_tokens_end_in_a_net_that_is_not_here_is_passed_over():
    assert told(NET.replace("out: a, emit: go_done", "out: [a, other.b]")) == []


def test_what_a_net_acts_on_is_there():
    lamps = NET.replace("}_arm", "}_lamp")
    acting = "net: m\nplaces: {b: 1}\ntransitions: {t: {in: b, out: b, topic: {name: /l, type: std_msgs/msg/Empty}%s}}"
    with pytest.raises(NetFileError, match="needs 'left_lamp'"):
        told(lamps)
    assert told(lamps, other=acting % ", acts_on: [left_lamp], on_failure: b") == []


def test_verify_tells_it_and_finds_modules_beside_the_file(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "hands_of_test_files.py").write_text("def act(ctx):\n    pass\n")
    file = tmp_path / "n.yaml"
    acting = "in: a, action: hands_of_test_files:act, on_failure: a,"
    file.write_text(NET.replace("in: a,", acting).replace('"${arguments.side}_arm"', ""))
    assert main(["verify", str(file)]) == OK
    file.write_text(NET.replace("commands", "#").replace(", emit: go_done", ""))
    assert main(["verify", str(file)]) == OK
    assert "\n  told          command go never ends well: no transition emits go_done\n" in capsys.readouterr().out
    file.write_text(NET.replace("go_done", "gone"))
    assert main(["verify", str(file)]) == BAD_INPUT
    assert "n.yaml:5: transitions.go: command go never ends well" in capsys.readouterr().err


def test_a_fault_in_an_included_file_is_named_there(tmp_path):
    (tmp_path / "part.yaml").write_text("transitions:\n\n  go: {in: a, out: a, action: no_such:act, on_failure: a}\n")
    (tmp_path / "n.yaml").write_text("net: n\ninclude: part.yaml\nplaces: {a: 1}\n")
    net = load_net(tmp_path / "n.yaml")
    with pytest.raises(ImError, match=r"part\.yaml:3: transitions\.go: action function 'no_such:act' cannot be loaded"):
        check_files([net], ())


LOOP = """
net: loop
places: {free: {tokens: 1, resource: true}, opened: , home: , missed: , arm: {tokens: 1, resource: true}}
escalate: missed
transitions:
  begin: {symbol: present, in: [free, arm], out: opened}
  go_home: {in: opened, out: %s, request: {to: motion_coordinator.move_robot}}
  give_up: {in: missed, out: [free, arm], emit: present_failed}
  acknowledge: {in: home, out: [free, arm], emit: present_done}
"""


@pytest.mark.parametrize("end", ["home", "opened"])
def test_a_command_whose_acknowledgement_nothing_enables_is_refused(end):
    report = verify([parse_net(LOOP % end)])
    said = [refusal.reason for refusal in report.refusals]
    assert said == ([] if end == "home" else ["command present never ends well: nothing enables acknowledge"])
    assert report.ok == (end == "home")


def test_nets_that_are_asked_and_not_given_are_named_before_the_answers():
    text = readable(verify([parse_net(LOOP % "home")]), {}).splitlines()
    assert text[1] == "  not looked at motion_coordinator (asked by loop)"
