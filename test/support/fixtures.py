"""Fixtures that tests of several packages share; a ``conftest.py`` takes what it needs."""

from pathlib import Path

import pytest

from bench.vss.cameras import drawn_truth

NETS = Path(__file__).parent / "nets"


@pytest.fixture
def data() -> Path:
    """Folder of net files."""
    return NETS


@pytest.fixture(scope="session")
def make_truth():
    """``make_truth(cell)``: what a simulated cell is really like."""
    return drawn_truth
