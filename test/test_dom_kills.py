"""What the store of data objects has acknowledged outlives kills and losses of power; ``bench.sh --dom`` has more."""

import pytest

from bench.dom import kills
from bench.dom.kills import kill_once


@pytest.mark.parametrize("power_lost", [False, True], ids=["kill", "power"])
def test_what_was_acknowledged_outlives_kills_and_losses_of_power_at_seeded_moments(tmp_path, power_lost):
    for seed in range(4):
        assert kill_once(tmp_path, seed, power=power_lost) > 0


FORGETFUL = """
import sqlite3, sys
from bench.dom import kills
connect = sqlite3.connect

class Forgetful(sqlite3.Connection):
    def execute(self, sql, *values):
        return super().execute(sql.replace("synchronous=FULL", "synchronous=NORMAL"), *values)

sqlite3.connect = lambda *args, **options: connect(*args, factory=Forgetful, **options)
kills.work(kills.Path(sys.argv[-2]), int(sys.argv[-1]), lambda line: print(line, flush=True))
"""


def test_a_store_that_waits_for_no_disk_forgets(tmp_path, monkeypatch):
    """Else the test above could not fail."""
    program = tmp_path / "forgetful.py"
    program.write_text(FORGETFUL)
    monkeypatch.setattr(kills, "COMMAND", (str(program),))
    (tmp_path / "store").mkdir()
    with pytest.raises(AssertionError, match="was acknowledged"):
        _lose_power(tmp_path / "store", 40)


def _lose_power(folder, times):
    for seed in range(times):
        kill_once(folder, seed, power=True)
