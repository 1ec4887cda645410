"""Every store survives a full disk: an error to the caller, and what was stored before is there."""

import subprocess
import sys

import pytest

from support.full_disk import STORES


def run(*argv):
    return subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False)


@pytest.mark.parametrize("store", STORES)
def test_a_file_that_may_not_grow(store, tmp_path):
    done = run(sys.executable, "-m", "support.full_disk", "limit", store, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert done.stdout


@pytest.mark.parametrize("store", STORES)
def test_a_file_system_without_room(store, tmp_path):
    if run("unshare", "--map-root-user", "--mount", "mount", "-t", "tmpfs", "tmpfs", str(tmp_path)).returncode != 0:
        pytest.skip("this process may not mount a file system of its own")
    unshared = ("unshare", "--map-root-user", "--mount", sys.executable)
    done = run(*unshared, "-m", "support.full_disk", "tmpfs", store, str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "No space left on device" in done.stdout or "full" in done.stdout
