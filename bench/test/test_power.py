"""What is moved is where it was moved to when the power has come back."""

import os
import subprocess
import sys
from random import Random

import pytest

from bench.power.disk import Disk
from im_bringup.machine import run_state
from im_core import unfinished_commands
from im_core.files import make_folder, write_whole
from im_core.unfinished_commands import OpenCommandNote

BEGINS = """
import sys
from pathlib import Path
from im_bringup.machine import run_state
from im_core import unfinished_commands
from im_core.files import make_folder, write_whole
folder = Path(sys.argv[1])
run_state.prepare(folder, True, print)
write_whole(make_folder(folder / "journal" / "dispatcher") / "1.journal", b"two")
unfinished_commands.note(folder, "dispatcher", [unfinished_commands.OpenCommandNote("dispatcher", 4, "move")])
"""


@pytest.mark.parametrize("seed", range(6))
def test_a_mission_that_was_set_aside_is_not_taken_for_one_that_is_being_so(tmp_path, seed):
    """Its name came back with the power, and the mission after it was set aside in its place."""
    folder = tmp_path / "run"
    write_whole(make_folder(folder / "journal" / "dispatcher") / "1.journal", b"one")
    unfinished_commands.note(folder, "dispatcher", [OpenCommandNote("dispatcher", 3, "home")])
    disk = Disk(folder)
    subprocess.run([sys.executable, "-c", BEGINS, str(folder)], env={**os.environ, **disk.environment}, check=True)
    disk.lose_power(Random(seed))
    said = []
    assert run_state.prepare(folder, False, said.append), said
    assert said[0].startswith("commands had not ended when the machine was: move (number 4 of dispatcher);")
    assert (folder / "journal" / "dispatcher" / "1.journal").read_bytes() == b"two"
    (aside,) = (folder / "missions").iterdir()
    assert (aside / "journal" / "dispatcher" / "1.journal").read_bytes() == b"one"
