"""What this host lacks is said in one sentence before anything starts."""

import resource
import shutil
import subprocess
import sys
from collections import namedtuple

import pytest

from im_bringup.machine import preflight
from im_bringup.tasks import deployment
from im_core.errors import ImError

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(autouse=True)
def folders(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path / "results"))


@pytest.fixture
def default():
    return deployment.load(deployment.default_path())


def with_free(monkeypatch, **free):
    """``shutil.disk_usage`` of a host with so many bytes free on the file systems that are named."""

    def disk_usage(path):
        return Usage(2**40, 0, next((count for name, count in free.items() if name in str(path)), 2**40))

    monkeypatch.setattr(shutil, "disk_usage", disk_usage)


def test_a_host_that_has_it_all(default, monkeypatch, tmp_path):
    with_free(monkeypatch)
    preflight.check(default)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["results", "run"]


def test_shared_memory_is_counted_from_the_tasks_and_the_profile(monkeypatch, tmp_path):
    profile = tmp_path / "fastdds.xml"
    profile.write_text("<a><segment_size>16777216</segment_size></a>")
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", str(profile))
    ten, eleven = preflight.shared_memory_bytes(10), preflight.shared_memory_bytes(11)
    assert 17_564_192 < eleven - ten < 20_000_000
    assert ten > 11 * 17_564_192 + 9_700_000


def test_full_shared_memory(default, monkeypatch):
    with_free(monkeypatch, shm=3 * 2**20)
    words = r"^/dev/shm has 3 MiB free, and the machine needs \d+ MiB .*; nothing was started$"
    with pytest.raises(ImError, match=words):
        preflight.check(default)


def test_a_full_disk(default, monkeypatch, tmp_path):
    with_free(monkeypatch, results=2**20)
    with pytest.raises(ImError, match=r"results has 1 MiB free, and 16 MiB are needed; nothing was started$"):
        preflight.check(default)


@pytest.mark.parametrize("variable", ["IM_RUN_DIR", "IM_RESULTS_DIR"])
def test_a_folder_that_cannot_be_made(default, monkeypatch, tmp_path, variable):
    (tmp_path / "file").touch()
    monkeypatch.setenv(variable, str(tmp_path / "file" / "folder"))
    with pytest.raises(ImError, match=r"file/folder cannot be made: Not a directory; nothing was started$"):
        preflight.check(default)


def test_a_folder_that_cannot_be_written(default, monkeypatch, tmp_path):
    read_only = tmp_path / "read_only"
    read_only.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "ro", "tmpfs", str(read_only)]
    program = (
        "import os; os.environ['IM_RESULTS_DIR'] = os.sys.argv[1]\n"
        "from im_bringup.machine import preflight\nfrom im_bringup.tasks import deployment\n"
        "try:\n    preflight.check(deployment.load(deployment.default_path()))\n"
        "except Exception as error:\n    print(error)"
    )
    shell = 'set -e; "${@:3}" || exit 77; exec "$0" -c "$1" "$2"'
    done = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "bash", "-c", shell, sys.executable, program, str(read_only), *mount],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    if done.returncode in (1, 77):
        pytest.skip("this process may not mount a file system of its own")
    trouble = "cannot be written: Read-only file system; nothing was started"
    assert done.stdout.strip() == f"{read_only}/.preflight {trouble}"


@pytest.fixture
def limits(monkeypatch):
    """Limits of open files that are only played."""
    now = {}
    monkeypatch.setattr(resource, "getrlimit", lambda _: now["limits"])
    monkeypatch.setattr(resource, "setrlimit", lambda _, limits: now.update(limits=limits))
    return now


def test_too_few_open_files(default, limits):
    limits["limits"] = (64, 64)
    with pytest.raises(ImError, match=r"may open 64 files here \(ulimit -n\), and up to 128 are needed; nothing"):
        preflight.check(default)


def test_a_soft_limit_of_open_files_is_raised(default, limits, monkeypatch):
    with_free(monkeypatch)
    limits["limits"] = (64, 4096)
    preflight.check(default)
    assert limits["limits"] == (128, 4096)
    limits["limits"] = (resource.RLIM_INFINITY, resource.RLIM_INFINITY)
    preflight.check(default)
    assert limits["limits"][0] == resource.RLIM_INFINITY
