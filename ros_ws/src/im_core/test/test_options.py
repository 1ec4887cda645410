"""Numbers on a command line: read as they are, or refused by what was given and what is allowed."""

import argparse

import pytest

from im_core.options import NumberParser, at_least, between, computing_seconds, finite_number, seconds, whole


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (finite_number, "-1e3", -1000.0),
        (seconds, "86400", 86_400.0),
        (computing_seconds, "1e9", 1e9),
        (whole, "-7", -7),
        (at_least(1), "+1", 1),
        (between(-10, 10), "-10", -10),
    ],
)
def test_a_number_is_read(read, text, value):
    assert read(text) == value


@pytest.mark.parametrize(
    ("read", "text", "message"),
    [
        (finite_number, "nan", "nan is not a finite number"),
        (finite_number, "x" * 1000, "x" * 60 + " is not a finite number"),
        (finite_number, "-inf", "-inf is not a finite number"),
        (seconds, "0", "0 is no time between 0 and 86400 s"),
        (seconds, "86401", "86401 is no time between 0 and 86400 s"),
        (computing_seconds, "-1", "-1 is no time above 0 s"),
        (whole, "1.0", "1.0 is not a whole number"),
        (whole, "1_0", "1_0 is not a whole number"),
        (whole, "9" * 5000, "9" * 60 + " is not a whole number"),
        (whole, "\u0663", "\u0663 is not a whole number"),
        (between(-10, 10), "11", "11 is no whole number from -10 to 10"),
        (finite_number, "", "'' is not a finite number"),
        (whole, "\n", "'\\n' is not a whole number"),
        (at_least(0), "-1", "-1 is no whole number from 0 on"),
    ],
)
def test_what_is_no_such_number_is_refused(read, text, message):
    with pytest.raises(argparse.ArgumentTypeError) as refused:
        read(text)
    assert str(refused.value) == message


@pytest.mark.parametrize("text", [repr(-1e-5), repr(-1e22), "-1.", "-.5E3", "-3", "-0.25"])
def test_a_negative_number_is_a_value_however_it_is_written(text):
    parser = NumberParser()
    parser.add_argument("--corner", nargs=3, type=finite_number)
    assert parser.parse_args(["--corner", "1", text, "2"]).corner == [1.0, float(text), 2.0]
    inner = parser.add_subparsers().add_parser("inner")
    inner.add_argument("place", type=finite_number)
    assert parser.parse_args(["inner", text]).place == float(text)


@pytest.mark.parametrize("text", ["-inf", "-nan"])
def test_a_negative_value_that_is_not_finite_is_refused_by_its_reader(text, capsys):
    parser = NumberParser()
    parser.add_argument("--x", type=finite_number)
    with pytest.raises(SystemExit):
        parser.parse_args(["--x", text])
    assert f"{text} is not a finite number" in capsys.readouterr().err


def test_what_only_begins_as_a_negative_number_is_an_option():
    parser = NumberParser()
    parser.add_argument("-o")
    parser.add_argument("--x", nargs="*")
    for words in (["-o", "-2"], ["-oa"], ["-o-1"]):
        assert parser.parse_args(["--x", "-1e3", *words]).x == ["-1e3"]
    with pytest.raises(SystemExit):
        parser.parse_args(["--x", "-1e"])
