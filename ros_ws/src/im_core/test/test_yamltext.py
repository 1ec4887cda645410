"""YAML to values that know where they stand, and in bounded time whatever the text is."""

import math

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import Field

from im_core.config import Model, fault_in, parse_model
from im_core.errors import ConfigError
from im_core.text.yamltext import Kind, RepeatedKeyError, YamlError, as_data, find, read_yaml, write_yaml

BOMB = "b0: &b0 [1]\n" + "".join(f"b{i + 1}: &b{i + 1} [{f'*b{i}, ' * 9}]\n" for i in range(9))


class Inner(Model):
    width: int = 0


class Outer(Model):
    parts: dict[str, Inner | None] = Field(default_factory=dict)
    list_of: tuple[Inner, ...] = ()


def test_a_location_is_followed_as_far_as_there_is_something():
    root = read_yaml("a:\n  - {b: 1}\n  - c\n", "f")
    found = find(root, ("a", 0, "b"))
    assert (found.value.text, found.value.line, found.value.column, found.location) == ("1", 2, 9, ("a", 0, "b"))
    assert find(root, ("a", 7)).location == ("a",)
    assert find(root, ("a", 0, "b", 0, "x")).location == ("a", 0, "b")
    assert find(root, ("x",)).value.kind is Kind.MAPPING


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**18), 10**18) | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("abc", min_size=1), inner, max_size=3),
    max_leaves=8,
)


@given(plain)
def test_what_another_library_writes_is_read_as_it_was(data):
    def same(one, other):
        if isinstance(one, float) and isinstance(other, float):
            return one == other or (math.isnan(one) and math.isnan(other))
        if isinstance(one, list) and isinstance(other, list):
            return len(one) == len(other) and all(map(same, one, other))
        if isinstance(one, dict) and isinstance(other, dict):
            return list(one) == list(other) and all(same(one[key], other[key]) for key in one)
        return type(one) is type(other) and one == other

    text = yaml.safe_dump(data, sort_keys=False)
    assert same(as_data(read_yaml(text, "f")), data), text


@given(st.text() | st.text("0123456789.eE+-_:yYnNoOaAfFiI~", max_size=6))
@example("1e3")
@example("-.5e1")
@example("NaN")
def test_a_text_that_is_written_is_a_text_for_every_reader(text):
    written = write_yaml({"a": text, "b": [text]})
    for data in (as_data(read_yaml(written, "f")), yaml.safe_load(written)):
        assert (data["a"], data["b"]) == (text, [text])


@pytest.mark.parametrize("text", ["y", "1e3", "nan", "-inf", "0x1F", "012", "1_000", "Infinity", "on", "12:30", "~"])
def test_a_text_that_may_be_taken_for_something_else_is_quoted(text):
    assert write_yaml([text]) == f"- '{text}'\n"


def test_a_key_twice_says_where_it_was_first():
    with pytest.raises(RepeatedKeyError, match="'a' is there twice; the first is in line 1") as error:
        as_data(read_yaml("x: {a: 1,\n  a: 2}", "f"))
    assert (error.value.place.line, error.value.location) == (2, ("x",))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a: " + "[" * 5000, "values nest deeper than 40"),
        ("a: &a {b: *a}", "contains itself"),
        (BOMB, "more than 500000 values"),
        ("? [a]\n: b", "a list is not a text"),
        ("a: !!python/object:os.system b", "tag .* is not allowed"),
        ("a: 1\n---\nb: 2", "a second document begins"),
    ],
)
def test_hostile_text_is_refused(text, complaint):
    with pytest.raises(YamlError, match=complaint):
        as_data(read_yaml(text, "f"))
    with pytest.raises(ConfigError, match=rf"^f:\d+: (\w+: )?.*{complaint}"):
        parse_model(text, Outer, "f")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("parts: {a: {wdth: 1}}", r"^f:1: parts\.a\.wdth: 1: Extra inputs .* \(did you mean 'width'\?\)$"),
        ("list_of:\n- {width: 1}\n- {wide: 1}", r"^f:3: list_of\[1\]\.wide: 1: Extra .*mean 'width'"),
        ("part: {}", r"^f:1: part: Extra inputs are not permitted \(did you mean 'parts'\?\)$"),
    ],
)
def test_the_nearest_right_key_is_named(text, complaint):
    with pytest.raises(ConfigError, match=complaint):
        parse_model(text, Outer, "f")


def test_very_many_faults_are_not_all_told():
    text = "".join(f"- {{x{i}: 1}}\n" for i in range(10_000))
    with pytest.raises(ConfigError) as error:
        parse_model(f"list_of:\n{text}", Outer, "f")
    assert 10 <= len(error.value.message.splitlines()) <= 100


def test_a_fault_that_a_model_cannot_see_is_placed_too(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("a:\n  b: 3\n")
    error = fault_in(file, ("a", "b"), "3 of 2")
    assert error.message == f"{file}:2: a.b: 3 of 2"
    assert (error.facts["line"], error.facts["column"], error.facts["field"]) == (2, 6, "a.b")
