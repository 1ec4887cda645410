import json
from itertools import pairwise
from xml.etree import ElementTree

import pytest

from im_pnt.cli import BAD_INPUT, OK, REFUSED, main
from im_pnt.draw import draw
from im_pnt.netfile import load_net


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


@pytest.mark.parametrize("phases", [False, True])
def test_drawings_have_every_part_and_no_overlap(data, tmp_path, phases):
    net = load_net(data / "coordinator.yaml")
    drawing = draw(net, phases=phases)
    names = {node.name for node in drawing.nodes}
    assert {"asked", "found", "not_found", "SI", "SO", "accept.find", "t_f.find", "return.find"} <= names
    assert ("search" in names) != phases
    assert ("search.active" in names) == phases
    rows: dict[float, list[tuple[float, float]]] = {}
    for node in drawing.nodes:
        x, y = drawing.layout.positions[node.name]
        rows.setdefault(y, []).append((x - node.width / 2, x + node.width / 2))
    for row in rows.values():
        row.sort()
        assert all(left[1] <= right[0] + 1e-6 for left, right in pairwise(row))
    output = tmp_path / "net.svg"
    assert main(["draw", str(data / "coordinator.yaml"), "-o", str(output)]) == OK
    root = ElementTree.parse(output).getroot()
    assert root.tag.endswith("svg")
    output = tmp_path / "net.dot"
    assert main(["draw", str(data / "coordinator.yaml"), "-o", str(output)]) == OK
    assert '"asked" -> "search"' in output.read_text()
