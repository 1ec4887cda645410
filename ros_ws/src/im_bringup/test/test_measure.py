import os

import pytest

from im_bringup.measure import Line, memory_mib, table


def test_bars_are_for_ratios_where_there_is_a_baseline():
    assert Line("servo", 4.51, "ms", 4.5, "nominal", bar=1.005).met
    assert Line("servo", 4.53, "ms", 4.5, "nominal", bar=1.005).met is False
    assert Line("speed", 300.0, "s", 50.0, "wall time", bar=5.0, at_least=True).met
    assert Line("speed", 200.0, "s", 50.0, "wall time", bar=5.0, at_least=True).met is False
    assert Line("start", 14.0, "s", bar=15.0).met
    assert Line("start", 14.0, "s").met is None


def test_the_table_says_how_many_bars_are_missed():
    good, bad = Line("start", 14.0, "s", bar=15.0), Line("speed", 100.0, "s", 50.0, "wall time", 5.0, True)
    assert table([good]).splitlines()[-1] == "all bars are met"
    text = table([good, bad])
    assert text.splitlines()[-1] == "1 bars are missed"
    assert ">= 5 MISSED 2 x wall time (50 s)" in text


def test_memory_of_this_process_is_between_one_and_a_thousand_mib():
    assert 1.0 < memory_mib([os.getpid()]) < 1000.0
    assert memory_mib([2**30]) == pytest.approx(0.0)
