import json
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, INTERRUPTED, OK, REFUSED


def test_verify_prints_one_object_with_every_answer(data, capsys):
    files = [str(data / "dispatcher.yaml"), str(data / "coordinator.yaml")]
    assert main(["verify", *files, "--json"]) == OK
    report = json.loads(capsys.readouterr().out)
    assert report["ok"]
    assert report["bounded"]
    assert not report["has_deadlock"]
    assert report["p_semiflows"]


def test_verify_says_why_a_net_is_refused(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    file.write_text("net: bad\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}}\n")
    assert main(["verify", str(file)]) == REFUSED
    out = capsys.readouterr().out
    assert "bad: REFUSED" in out
    assert "it is stuck with b=1" in out
    assert "after       t" in out


def test_the_verdict_on_the_net_of_the_readme_fits_a_screen(capsys):
    root = Path(__file__).resolve().parents[4]
    (net,) = re.findall(r"^scripts/im pnt verify (ros_ws/\S+)", (root / "README.md").read_text(), re.MULTILINE)
    assert main(["verify", str(root / net)]) == OK
    verdict = capsys.readouterr().out.splitlines()
    assert verdict[0] == "calibrate_camera: verified"
    assert len(verdict) <= 10
    assert max(map(len, verdict)) < 120
    (left_out,) = (re.findall(r"\d+", line) for line in verdict if "left out" in line)
    assert main(["verify", str(root / net), "--all"]) == OK
    everything = capsys.readouterr().out.splitlines()
    assert "--all" not in "".join(everything)
    more = ["reversible", "never enabled", "types"]
    assert [line[2:16].strip() for line in everything if line[2:16].strip() in more] == more
    assert len(everything) == len(verdict) - 1 + sum(map(int, left_out)) + len(more)


def test_of_several_refusals_the_first_is_told_and_the_others_are_counted(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    transitions = "{fill: {in: a, out: [a, c]}, grow: {in: a, out: [a, b]}}"
    file.write_text(f"net: bad\nplaces: {{a: 1, b: , c: {{capacity: 1}}}}\ntransitions: {transitions}\n")
    assert main(["verify", str(file)]) == REFUSED
    told = capsys.readouterr().out
    assert told.count("  refused  ") == 1
    assert "left out      1 refusal, 1 invariant (--all)" in told
    assert main(["verify", str(file), "--all"]) == REFUSED
    assert capsys.readouterr().out.count("  refused  ") == 2


def test_bad_input_is_one_sentence_with_file_and_line(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    file.write_text("net: bad\nplaces: {a: 1}\ntransitions: {t: {in: b}}\n")
    assert main(["verify", str(file)]) == BAD_INPUT
    assert "bad.yaml:3:23: transitions.t.in: there is no place 'b' (known: a)" in capsys.readouterr().err
    assert main(["draw", str(file), "-o", "x.png"]) == BAD_INPUT


TYPED = """
net: typed
places: {a: 1}
transitions:
  say:
    symbol: s
    in: a
    out: a
    topic: {name: /t, type: std_msgs/msg/TYPE, message: {data: VALUE}}
    on_failure: a
"""


@pytest.mark.parametrize(
    ("of", "value", "sentence"),
    [
        ("Int32", "word", "typed.yaml:9:65: transitions.say.topic.message.data: "),
        ("Strin", "1", "transitions.say.topic.type: "),
    ],
)
def test_verify_checks_values_against_the_types_of_messages(tmp_path, capsys, of, value, sentence):
    file = tmp_path / "typed.yaml"
    file.write_text(TYPED.replace("TYPE", of).replace("VALUE", value))
    assert main(["verify", str(file)]) == BAD_INPUT
    assert sentence in capsys.readouterr().err
    file.write_text(TYPED.replace("TYPE", "String").replace("VALUE", "word"))
    assert main(["verify", str(file)]) == OK
    assert "types" not in capsys.readouterr().out
    assert main(["verify", str(file), "--all"]) == OK
    assert "types         values fit the types of the messages" in capsys.readouterr().out


def test_verify_says_where_it_cannot_check_types(tmp_path, capsys, monkeypatch):
    def no_ros(group):
        if group == "im_pnt.message_types":
            raise ModuleNotFoundError("No module named 'rclpy'", name="rclpy")
        return []

    monkeypatch.setattr("im_pnt_analysis.cli.verify.extensions", no_ros)
    file = tmp_path / "typed.yaml"
    file.write_text(TYPED.replace("TYPE", "Int32").replace("VALUE", "word"))
    assert main(["verify", str(file)]) == OK
    assert "types         not checked: there is no ROS here" in capsys.readouterr().out
    assert main(["verify", str(file), "--json"]) == OK
    assert json.loads(capsys.readouterr().out)["types"].startswith("not checked")


def test_a_program_that_needs_ros_says_so(capsys, monkeypatch):
    def no_ros(group, name):
        raise ModuleNotFoundError(f"No module named 'rclpy' for {group} {name}", name="rclpy")
        yield  # as entry points are loaded one by one

    monkeypatch.setattr(sys.modules[main.__module__], "extensions", no_ros)
    for program in ("run", "mission"):
        assert main([program, "net.yaml"]) == BAD_INPUT
        assert capsys.readouterr().err == f"pnt: {program} needs ROS, which was not sourced (rclpy is not found)\n"


def test_a_wrong_type_of_an_argument_is_named_beside_all_that_are_allowed(tmp_path, capsys):
    file = tmp_path / "kinds.yaml"
    file.write_text(
        "net: n\ncommands: {go: {arguments: {x: {type: int}}}}\nplaces: {a: 1}\n"
        "transitions: {go: {symbol: go, in: a, out: a}}\n"
    )
    assert main(["verify", str(file)]) == BAD_INPUT
    said = capsys.readouterr().err
    assert "kinds.yaml:2:39: commands.go.arguments.x.type: " in said
    assert said.endswith("'integers', 'numbers', 'strings' or 'object', not 'int'\n")


def test_xml_under_another_name_is_said_to_be_xml(tmp_path, capsys):
    file = tmp_path / "model.cpn"
    file.write_text('<?xml version="1.0"?>\n<workspaceElements/>\n')
    assert main(["verify", str(file)]) == BAD_INPUT
    said = "model.cpn:1:1: is XML; im pnt convert makes YAML of a net in .pnml, .xml or .tapn\n"
    assert capsys.readouterr().err.endswith(said)


def test_simulation_is_repeatable(data, capsys):
    runs = []
    for _ in range(2):
        assert main(["simulate", str(data / "coordinator.yaml"), "--seed", "3", "--steps", "20"]) == OK
        runs.append(capsys.readouterr().out)
    assert runs[0] == runs[1]
    assert runs[0].count("\n") == 21


def test_draw_writes_svg_and_dot(data, tmp_path):
    output = tmp_path / "net.svg"
    assert main(["draw", str(data / "coordinator.yaml"), "-o", str(output)]) == OK
    root = ElementTree.parse(output).getroot()
    assert root.tag.endswith("svg")
    output = tmp_path / "net.dot"
    assert main(["draw", str(data / "coordinator.yaml"), "-o", str(output)]) == OK
    assert '"asked" -> "search"' in output.read_text()


def test_verify_answers_everything_and_says_how(data, capsys):
    main(["verify", str(data / "coordinator.yaml"), "--json"])
    report = json.loads(capsys.readouterr().out)
    wanted = (
        "states labelled_arcs distinct_edges max_token_in_place max_token_per_marking place_bounds bounded safe "
        "has_deadlock deadlock_states live live_transitions quasi_live reversible terminal_sccs "
        "never_enabled_transitions never_enabled p_semiflows t_semiflows siphons traps"
    )
    for answer in wanted.split():
        assert report[answer] is not None
        assert report["methods"][answer]
    assert report["unknown"] == {}
    assert report["time_s"] >= 0.0


def test_a_counterexample_is_written_and_can_be_played(tmp_path, capsys):
    net = tmp_path / "grows.yaml"
    net.write_text("net: grows\nplaces: {a: 1, b: , c: }\ntransitions: {s: {in: a, out: c}, t: {in: c, out: [c, b]}}\n")
    written = tmp_path / "way.json"
    assert main(["verify", str(net), "--counterexample", str(written)]) == REFUSED
    out = capsys.readouterr().out
    assert "place b can grow without end" in out
    way = json.loads(written.read_text())
    assert way["nets"] == ["grows"]
    assert way["sequence"] == ["s", "t"]
    assert way["repeat_from"] == 1
    assert way["marking"] == {"b": 1, "c": 1}
    assert main(["simulate", str(net), "--replay", str(written)]) == OK
    assert main(["verify", str(net), "--counterexample", str(tmp_path / "no" / "way.json")]) == BAD_INPUT
    assert "No such file" in capsys.readouterr().err
    text = net.read_text()
    assert main(["verify", str(net), "--counterexample", str(net)]) == BAD_INPUT
    assert "is one of the nets" in capsys.readouterr().err
    assert net.read_text() == text


def test_draw_says_whose_it_is_where_the_display_is_not_installed(data, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys.modules["im_pnt_analysis.cli.main"], "extensions", lambda group: iter(()))
    assert main(["draw", str(data / "coordinator.yaml"), "-o", str(tmp_path / "net.svg")]) == BAD_INPUT
    said = capsys.readouterr().err
    assert said == "pnt: draw is a command of the package im_pnt_display, which is not installed\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "draw" not in capsys.readouterr().out


def test_what_cannot_be_said_is_no_refusal_of_the_net(tmp_path):
    net = tmp_path / "a.yaml"
    net.write_text("net: a\nplaces: {idle: 1}\ntransitions: {go: {in: idle, out: idle, symbol: s, emit: s_done}}\n")
    run = [sys.executable, "-m", "im_pnt_analysis", "verify", str(net)]
    with open("/dev/full", "w") as full:
        done = subprocess.run(run, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (BAD_INPUT, "pnt: [Errno 28] No space left on device\n")
    closed = ["bash", "-c", '"$@" >&-', "-", *run]
    done = subprocess.run(closed, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (OK, "")


def test_an_interrupt_is_a_word(monkeypatch, capsys):
    def interrupted(options):
        raise KeyboardInterrupt

    monkeypatch.setattr("im_pnt_analysis.cli.simulate.run", interrupted)
    assert main(["simulate", "any.yaml"]) == INTERRUPTED
    assert capsys.readouterr().err == "\npnt: interrupted\n"
