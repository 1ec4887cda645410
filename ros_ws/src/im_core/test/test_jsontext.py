import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import ImError
from im_core.files import FileError
from im_core.text.jsontext import MAX_DEPTH, JsonError, decode_json, load_json

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**19), 10**19) | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"])),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=12,
)  # fmt: skip


@given(VALUES)
def test_data_come_back_as_they_were_written(data):
    assert decode_json(json.dumps(data)) == data
    assert decode_json(json.dumps(data, ensure_ascii=False)) == data


@given(st.text(alphabet='[]{}",:0123456789.eE-+ntfalsruN\\ud8\n ', max_size=60))
def test_any_text_is_data_or_one_sentence(text):
    said, data = "", None
    try:
        data = decode_json(text)
    except JsonError as error:
        said = error.sentence
    assert "\n" not in said
    json.dumps(data, ensure_ascii=False, allow_nan=False).encode()


def nested(depth, opening="[", closing="]"):
    return opening * depth + "1" + closing * depth


def test_what_is_nested_as_deep_as_allowed_is_read():
    assert decode_json(nested(MAX_DEPTH))
    assert decode_json(nested(MAX_DEPTH, '{"a":', "}"))


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (nested(MAX_DEPTH + 1), "values nest deeper than 40"),
        (nested(MAX_DEPTH + 1, '{"a":', "}"), "values nest deeper than 40"),
        (nested(100_000), "values nest deeper than 40"),
        ("[" + "1," * 5_000_000 + "1]", "more than 5000000 values, the most allowed"),
        ("NaN", "NaN is not a number of JSON"),
        ("[-Infinity]", "-Infinity is not a number of JSON"),
        ("1e999", "the number 1e999 is too large"),
        ("9" * 5000, f"the number {'9' * 40} is too large"),
        ('{"a": 1, "b": 2, "a": 3}', "the key 'a' is there twice"),
        ('{"a": "\\ud800"}', "text with U+D800, which is half a character, is not allowed"),
        ('{"\\uDFFF": 1}', "text with U+DFFF, which is half a character, is not allowed"),
        ("", "not JSON: Expecting value"),
        ('{"a":\n1', "not JSON: Expecting ',' delimiter"),
    ],
)
def test_what_no_data_need_is_refused(text, sentence):
    with pytest.raises(JsonError) as refused:
        decode_json(text)
    assert refused.value.sentence == sentence


def test_whole_characters_and_large_whole_numbers_are_read():
    assert decode_json('"\\ud83d\\ude00"') == "\U0001f600"
    assert decode_json("1" * 30) == pytest.approx(math.pow(10, 30) / 9)


def test_a_file_is_named_with_line_and_column(tmp_path):
    path = tmp_path / "a.json"
    path.write_text('{\n "a": nothing}')
    with pytest.raises(FileError, match=r"a\.json:2:7: not JSON: Expecting value"):
        load_json(path)
    path.write_text("\ufeff[1]", encoding="utf-8")
    assert load_json(path) == [1]
    assert issubclass(FileError, ImError)
