"""Numbers on a command line: read as they are, or refused by what was given and what is allowed."""

import argparse

import pytest

from im_core.options import at_least, computing_seconds, finite_number, seconds, whole


@pytest.mark.parametrize(
    ("read", "text", "value"),
    [
        (finite_number, "-1e3", -1000.0),
        (seconds, "86400", 86_400.0),
        (computing_seconds, "1e9", 1e9),
        (whole, "-7", -7),
        (at_least(1), "+1", 1),
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
        (at_least(0), "-1", "-1 is no whole number from 0 on"),
    ],
)
def test_what_is_no_such_number_is_refused(read, text, message):
    with pytest.raises(argparse.ArgumentTypeError) as refused:
        read(text)
    assert str(refused.value) == message
