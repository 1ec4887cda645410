"""Errors carry their facts and read as sentences."""

import os
from unittest.mock import patch

import pytest

from im_core.errors import (
    DataError,
    ImError,
    LimitError,
    NotFoundError,
    StateError,
    WaitTimeoutError,
    require_text,
)
from im_core.names import instance, results_dir, run_dir


def test_facts_are_kept() -> None:
    error = LimitError(joint="left_j3", value=2.91, limit=2.8, unit="rad")
    assert str(error) == "left_j3: position 2.91 rad is beyond the limit 2.8 rad"
    assert error.facts == {"joint": "left_j3", "value": 2.91, "limit": 2.8, "unit": "rad", "what": "position"}
    assert error.code == "limit"


def test_the_nearest_name_is_offered_only_if_it_is_near() -> None:
    known = ["ceiling_left", "wall"]
    assert "did you mean 'ceiling_left'?" in NotFoundError(kind="camera", name="celing_left", known=known).message
    far = NotFoundError(kind="camera", name="zzz", known=known).message
    assert far == "there is no camera 'zzz' (known: ceiling_left, wall)"
    assert "camera 'a\\nb'" in NotFoundError(kind="camera", name="a\nb").message


def test_of_many_names_the_first_are_listed_and_none_is_compared() -> None:
    known = [f"observation/{number:05}" for number in range(10_000)]
    with patch("difflib.get_close_matches", side_effect=AssertionError):
        error = NotFoundError(kind="data object", name="observation/x", known=known)
    assert error.message == f"there is no data object 'observation/x' (known: {', '.join(known[:30])}, ...)"
    assert error.facts["known"] == known[:30]


def test_a_time_out_says_what_it_waited_for() -> None:
    assert WaitTimeoutError(what="a spot", seconds=20.0).message == "waited 20 s for a spot, in vain"


def test_an_error_of_another_process_is_restored() -> None:
    restored = ImError.restored("state", "no", {"state": "cold"})
    assert (restored.code, restored.message, restored.facts) == ("state", "no", {"state": "cold"})
    assert StateError("no").code == "state"


@pytest.mark.parametrize(("domain", "expected"), [("", "im0"), ("7", "im7")])
def test_machines_differ_by_domain(domain: str, expected: str, tmp_path: os.PathLike[str]) -> None:
    variables = {"ROS_DOMAIN_ID": domain, "IM_RUN_DIR": f"{tmp_path}/run", "IM_RESULTS_DIR": f"{tmp_path}/results"}
    with patch.dict(os.environ, variables):
        assert instance() == expected
        assert run_dir().is_dir()
        assert results_dir().is_dir()


@pytest.mark.parametrize("name", ["\ud800", "a\0b", "\udfff\0"])
def test_a_message_can_be_published_whatever_it_speaks_of(name: str) -> None:
    """Half a character ends the process of whoever publishes it; a zero cuts the text."""
    message = ImError(f"there is no camera {name}").message
    assert "\0" not in message
    assert message.encode().decode() == message
    assert str(StateError(name)) == StateError(name).message


@pytest.mark.parametrize("text", ["", "wall", "\U0001f916 ü", "a\nb"])
def test_text_is_what_messages_can_carry(text):
    assert require_text(text, "it") is text


@pytest.mark.parametrize("text", ["\ud800", "ab\udfff", b"\xff".decode(errors="surrogateescape")])
def test_half_a_character_is_refused(text):
    with pytest.raises(DataError, match=r"it with U\+D[0-9A-F]{3}, which is half a character, is not allowed"):
        require_text(text, "it")


@pytest.mark.parametrize(("variable", "folder"), [("IM_RUN_DIR", run_dir), ("IM_RESULTS_DIR", results_dir)])
def test_a_folder_whose_name_no_message_can_carry_is_refused(monkeypatch, tmp_path, variable, folder):
    monkeypatch.setenv(variable, f"{tmp_path}/\udcff")
    with pytest.raises(DataError, match=f"the folder {variable} with U"):
        folder()
    assert list(tmp_path.iterdir()) == []
