"""Every store survives each failing call of the disk, and each failing allocation: nothing acknowledged is lost."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from support.failing_disk import STORES

SOURCE = Path(__file__).parent / "support" / "failing_disk.c"


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    """The failing disk, compiled."""
    path = tmp_path_factory.mktemp("failing_disk") / "failing_disk.so"
    subprocess.run(["gcc", "-O1", "-fPIC", "-shared", "-o", path, SOURCE, "-ldl"], check=True)
    return path


@pytest.fixture
def folder():
    """A folder in memory: hundreds of stories wait for no disk."""
    with tempfile.TemporaryDirectory(dir="/dev/shm") as path:
        yield path


@pytest.mark.parametrize("store", STORES)
def test_each_call_of_the_disk_fails_in_turn(store, library, folder):
    environment = {**os.environ, "LD_PRELOAD": str(library), "PYTHONMALLOC": "malloc"}
    done = subprocess.run(
        [sys.executable, "-m", "support.failing_disk", store, folder],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
        timeout=900,
    )
    assert done.returncode == 0, done.stderr[-2500:]
    assert int(done.stdout) > 80
