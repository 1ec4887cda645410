"""What the store of data objects has acknowledged outlives kill -9; ``scripts/bench.sh --dom kills`` kills more."""

import pytest

from bench.dom.kills import kill_once


@pytest.mark.parametrize("seeds", [range(8), range(8, 16), range(16, 24)])
def test_what_was_acknowledged_outlives_kills_at_seeded_moments(tmp_path, seeds):
    for seed in seeds:
        assert kill_once(tmp_path, seed) > 0
