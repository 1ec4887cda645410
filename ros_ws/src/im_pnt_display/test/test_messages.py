"""Whatever nodes tell of their nets is shown, or refused with a sentence."""

import json

import pytest

from im_core.errors import ImError
from im_pnt_display.page.messages import (
    counterexample,
    described_net,
    finite,
    phase_name,
    result_pictures,
    token_counts,
)

NET = "net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: [a, b]}}\n"
HUGE = json.dumps({"yaml": "# x\n" * 2_500_000})
NOT_OBJECTS = ("", "[]", "5", "null", '"text"', "{", "[" * 100_000, HUGE)


def told(**content):
    return json.dumps(content)


def refusal(**changes):
    return told(**{"reason": "b grows", "nets": [NET], "sequence": ["t"], "repeat": ["t"], **changes})


def test_a_net_is_described_with_its_drawing():
    content = described_net("n", told(yaml=NET, net="other", kind="snapshot"), "/node")
    assert content["net"] == "n"
    assert {node["name"] for node in content["drawing"]["nodes"]} == {"a", "b", "t"}
    assert "kind" not in content


@pytest.mark.parametrize(
    "text",
    [
        *NOT_OBJECTS,
        "{}",
        told(yaml=None),
        told(yaml=5),
        told(yaml=["net: n"]),
        told(yaml=""),
        told(yaml="a: [b"),
        told(yaml="[" * 50_000),
        told(yaml="net: 5"),
        told(yaml=NET.replace("in: a", "in: nowhere")),
        told(yaml=NET.replace("net: n", "net: other")),
    ],
)
def test_what_is_no_net_is_refused(text):
    with pytest.raises(ImError):
        described_net("n", text, "/node")


def test_a_refusal_is_played_with_what_repeats():
    content = counterexample(refusal())
    assert content["repeats"] == 1
    assert [step["fired"] for step in content["steps"]] == ["", "t", "t"]
    assert counterexample("{}") == {}
    assert counterexample(refusal(nets=[])) == {}


@pytest.mark.parametrize(
    "text",
    [
        *NOT_OBJECTS,
        refusal(reason=None),
        refusal(nets=NET),
        refusal(nets=[NET, NET]),
        refusal(nets=[5]),
        refusal(nets=["[" * 50_000]),
        refusal(sequence="t"),
        refusal(sequence=[{}]),
        refusal(sequence=["unknown"]),
        refusal(repeat=5),
    ],
)
def test_what_is_no_counterexample_is_refused(text):
    with pytest.raises(ImError):
        counterexample(text)


def test_places_and_their_tokens_come_in_pairs():
    assert token_counts(["a", "b"], [1, 2]) == {"a": 1, "b": 2}
    with pytest.raises(ImError, match="2 places and 1 numbers"):
        token_counts(["a", "b"], [1])


@pytest.mark.parametrize(("phase", "name"), [(0, "START"), (2, "FAILED"), (4, "DOUBT"), (77, "77")])
def test_a_phase_that_is_not_known_is_shown_by_its_number(phase, name):
    assert phase_name(phase) == name


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
def test_numbers_that_no_page_can_read_are_refused(value):
    assert finite("duration", 0.5) == 0.5
    with pytest.raises(ImError, match="its duration is"):
        finite("duration", value)


def test_pictures_of_a_result_are_those_of_its_folder_of_results(tmp_path):
    for folder, name in (
        ("results/7", "b.png"),
        ("results/7", "a.png"),
        ("results/7", "report.json"),
        ("else", "c.png"),
    ):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
        (tmp_path / folder / name).touch()
    results = tmp_path / "results"

    def found(directory):
        return result_pictures({"directory": json.dumps(directory)}, results)

    assert found(str(results / "7")) == ["7/a.png", "7/b.png"]
    assert found(str(tmp_path / "else")) == found(str(results / "none")) == found(7) == []
    assert result_pictures({"directory": "/cut..."}, results) == result_pictures({}, results) == []
