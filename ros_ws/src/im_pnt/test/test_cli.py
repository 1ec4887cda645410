import json
from xml.etree import ElementTree

from im_pnt.cli import BAD_INPUT, OK, REFUSED, main


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


def test_bad_input_is_one_sentence_with_file_and_line(tmp_path, capsys):
    file = tmp_path / "bad.yaml"
    file.write_text("net: bad\nplaces: {a: 1}\ntransitions: {t: {in: b}}\n")
    assert main(["verify", str(file)]) == BAD_INPUT
    assert "bad.yaml:3: transitions.t.in: there is no place 'b' (known: a)" in capsys.readouterr().err
    assert main(["draw", str(file), "-o", "x.png"]) == BAD_INPUT


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
