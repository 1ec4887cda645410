"""What arrives in messages is read, or refused with a sentence; nothing else."""

import json
from enum import IntEnum

import pydantic
import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError
from im_core.text.bounded_json import LARGEST, member, read_json


class Colour(IntEnum):
    RED = 0
    BLUE = 3


class Described(pydantic.BaseModel):
    yaml: str
    journal: bool = False


def test_what_fits_is_read():
    assert read_json(dict[str, bool], '{"left_led": true}', "the lights") == {"left_led": True}
    assert read_json(Described, '{"yaml": "net: a", "more": 1}', "a net") == Described(yaml="net: a")
    assert member(Colour, 3, "colour") is Colour.BLUE


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[]", "the lights cannot be read: Input should be an object"),
        ("", "the lights cannot be read: Invalid JSON"),
        ('{"left_led": 3}', "left_led: Input should be a valid boolean"),
        ('{"left_led": ' + "[" * 100_000, "recursion limit"),
        ('{"\ud800": true}', "unable to parse raw data as a unicode string"),
        (" " * (LARGEST + 1), f"{LARGEST + 1} characters; {LARGEST} are read"),
        ("NaN", "cannot be read"),
        ('{"left_led": ' + "9" * 5000 + "}", "number out of range"),
        ('{"left_led": true, "left_led": false}', "the lights cannot be read: the key 'left_led' is there twice"),
    ],
)
def test_what_does_not_fit_is_refused(text, words):
    with pytest.raises(DataError) as refused:
        read_json(dict[str, bool], text, "the lights")
    assert words in refused.value.message


def test_a_number_that_stands_for_nothing_is_refused_with_those_that_do():
    with pytest.raises(DataError, match=r"^colour 77 does not exist; there are 0 RED, 3 BLUE$"):
        member(Colour, 77, "colour")


@given(st.text() | st.recursive(st.none() | st.booleans() | st.floats(), st.lists).map(json.dumps))
def test_any_text_is_read_or_refused(text):
    try:
        lights = read_json(dict[str, bool], text, "the lights")
    except DataError:
        return
    assert all(isinstance(name, str) and isinstance(lit, bool) for name, lit in lights.items())
