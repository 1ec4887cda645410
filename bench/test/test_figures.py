import json

from bench.figures import Line, table, write


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


def test_what_could_not_be_measured_is_neither_met_nor_missed_and_says_why():
    unknown = Line("firings", None, "1/s", None, "SNAKES cannot be installed", bar=50.0, at_least=True)
    assert unknown.met is None
    text = table([unknown, Line("start", 14.0, "s", bar=15.0)])
    assert "SNAKES cannot be installed" in text
    assert text.splitlines()[-1] == "all bars are met, 1 figures could not be measured"


def test_the_file_holds_every_line_with_its_verdict(tmp_path):
    write(tmp_path / "bench.json", [Line("start", 14.0, "s", 7.0, "bare nodes", bar=3.0)])
    (line,) = json.loads((tmp_path / "bench.json").read_text())
    assert (line["measure"], line["met"]) == (2.0, True)
