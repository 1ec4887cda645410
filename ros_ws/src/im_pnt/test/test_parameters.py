"""Parameters of a net file: what the cell has, put in before the net is read."""

from pathlib import Path

import pytest

from im_pnt.errors import MissingPartsError, NetFileError
from im_pnt.netfile import load_net, parameters, parse_net, yaml_text

GIVEN = {"arms": ["one", "two"], "lights": [], "stroke": 0.08, "homes": [[0.0, -0.5], [1.5]], "words": ["on", "2"]}
NET = """
net: turn
parameters: {parameters}
commands:
  turn:
    needs: [zone, $(arms), "${{arguments.group}}_arm"]
    arguments:
      group: {{type: string, choices: $(arms), default: "$(arms[1])"}}
      out: {{type: numbers, length: [0, $(len(arms))], default: "$(homes[0])"}}
      width: {{type: number, maximum: $(stroke), minimum: $(-stroke), default: 0.0}}
      word: {{type: string, choices: $(words), default: "$(words[0])"}}
places: {{free: {{tokens: $(len(arms)), resource: true}}, turned: }}
transitions:
  turn: {{symbol: turn, in: free, out: turned}}
  end: {{in: turned, out: free, emit: turn_done}}
"""


@pytest.fixture(autouse=True)
def _cell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parameters, "extensions", lambda group: [lambda: GIVEN])


def net(declared: str) -> str:
    return NET.format(parameters=declared)


def test_values_keep_their_types_and_a_list_in_a_list_is_spread() -> None:
    read = parse_net(net("[arms, stroke, homes, words]"))
    command = read.commands["turn"]
    group, out, width, word = command.arguments.arguments.values()
    assert command.needs == ("zone", "one", "two", "${arguments.group}_arm")
    assert (group.choices, group.default, read.places["free"].tokens) == (("one", "two"), "two", 2)
    assert (out.length, out.default, width.minimum, width.maximum) == ((0, 2), [0.0, -0.5], -0.08, 0.08)
    assert (word.choices, word.default) == (("on", "2"), "on")
    assert parse_net(yaml_text(read)).commands == read.commands  # written out, it is no template any more


@pytest.mark.parametrize(
    ("declared", "error", "sentence"),
    [
        (
            "[arms, stroke, homes, words, lights]",
            MissingPartsError,
            "3:13: it needs 1 of the lights of the cell, which",
        ),
        (
            "{arms: 3, stroke: 1, homes: 1, words: 1}",
            MissingPartsError,
            "it needs 3 of the arms of the cell, which has 2",
        ),
        ("[arms, strok]", NetFileError, r"nobody gives the parameter 'strok' \(did you mean 'stroke'"),
        ("[arms, homes, words]", NetFileError, "commands: .*stroke"),
        ("{arms: none}", NetFileError, "parameters.arms"),
    ],
)
def test_what_there_is_too_little_of_or_nobody_gives_is_named(declared: str, error: type, sentence: str) -> None:
    with pytest.raises(error, match=sentence):
        parse_net(net(declared))


def test_templates_of_an_included_file_see_its_parameters_beside_their_own(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text(
        "parameters: [arms]\n"
        "templates:\n"
        "  step:\n"
        "    parameters: [arm]\n"
        "    places: {at_$(arm): }\n"
        '    transitions: {"go_$(arm)": {in: free, out: at_$(arm), title: "$(arm) of $(len(arms))"}}\n'
        "    rest: at_$(arm)\n"
        "use: {template: step, for: {arm: $(arms)}}\n"
    )
    file = tmp_path / "net.yaml"
    file.write_text("net: steps\ninclude: part.yaml\nplaces: {free: 1}\ntransitions: {back: {in: at_one, out: free}}\n")
    read = load_net(file)
    assert [read.transitions[f"go_{arm}"].title for arm in GIVEN["arms"]] == ["one of 2", "two of 2"]
