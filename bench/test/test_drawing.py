"""docs/mcs.md: its figures say what the code says, and the tests, topics and configuration it names exist."""

import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from bench.mcs.drawing import FIGURES, figure_7
from im_mcs.state.table import TABLE

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "mcs.md"


@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_are_those_of_the_code(name):
    drawn = (ROOT / "docs" / "images" / name).read_text(encoding="utf-8")
    assert drawn == FIGURES[name](), "run: python -m bench.mcs.drawing docs/images"
    assert f"images/{name}" in PAGE.read_text(encoding="utf-8")


def test_every_row_of_the_state_table_is_in_the_figure():
    words = " ".join(text.text or "" for text in ElementTree.fromstring(figure_7()).iter() if text.tag.endswith("text"))
    for row in TABLE:
        assert row.event.value in words
        assert row.source.value in words


def test_the_tests_that_the_page_names_exist():
    named = set(re.findall(r"`(test_\w+\.py)`", PAGE.read_text(encoding="utf-8")))
    assert len(named) > 10
    there = {path.name for folder in ("ros_ws/src", "test") for path in (ROOT / folder).rglob("test_*.py")}
    assert named <= there, named - there
