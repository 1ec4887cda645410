"""The wall clock of a machine is set while it works: nothing hangs, nothing is lost, no task is started again."""

import json
import mmap
import signal
import struct
import subprocess
import urllib.request
from pathlib import Path

import pytest

from im_bag import BagReader
from im_core import names
from im_msgs.srv import GetObject, PutObject
from support.whole_machine import COMMAND_S, ROOT, free_port, run_script, running_machine, write_few_poses

pytestmark = pytest.mark.end_to_end

SOURCE = Path(__file__).parent / "support" / "jumping_clock.c"
HOUR_S = 3600


@pytest.fixture
def set_clock(tmp_path, monkeypatch):
    """``set_clock(seconds)``: how far the clock of all that is started from now on is ahead of that of the test."""
    library, ahead = tmp_path / "jumping_clock.so", tmp_path / "ahead"
    subprocess.run(["gcc", "-O1", "-fPIC", "-shared", "-o", library, SOURCE, "-ldl"], check=True)
    ahead.write_bytes(bytes(8))
    monkeypatch.setenv("LD_PRELOAD", str(library))
    monkeypatch.setenv("JUMPING_CLOCK", str(ahead))
    with ahead.open("r+b") as file, mmap.mmap(file.fileno(), 8) as shared:

        def set_ahead(seconds):
            shared[:] = struct.pack("q", seconds)

        yield set_ahead


def put(machine, text):
    """Store a version of an object; return its number."""
    stored = machine.call(
        PutObject, "/dom/put", name="note", type="std_msgs/msg/String", json=json.dumps({"data": text})
    )
    assert stored.success, stored.status.message
    return stored.object.version


def noted(machine, version):
    """Return what a version of the object says."""
    found = machine.call(GetObject, "/dom/get", name="note", version=version, as_json=True)
    assert found.success, found.status.message
    return json.loads(found.json)["data"]


def incarnations(machine):
    machine.all_ready()
    return {name: task.incarnation for name, task in machine.tasks.items()}


def test_a_machine_works_on_while_its_clock_is_set_by_an_hour_and_back(set_clock, process, tmp_path, wait_until):
    port, bag = free_port(), tmp_path / "bag"
    poses = write_few_poses(tmp_path)
    with running_machine(port=port) as machine:
        record = process("bash", ROOT / "scripts" / "record.sh", "-o", bag, "--topics", "/pnt/firings")
        wait_until(lambda: "Ctrl-C ends it" in record.out.read_text(), "the recorder")
        before, first = incarnations(machine), put(machine, "before")
        calibration, answers = machine.in_background(poses)
        machine.wait_for_firing("calibrate_camera", "move_robot", 2)
        set_clock(HOUR_S)
        second = put(machine, "an hour later")
        machine.wait_for_firing("calibrate_camera", "move_robot", 3)
        set_clock(-HOUR_S)
        third = put(machine, "an hour earlier")
        calibration.join(COMMAND_S)
        assert answers[0].success, answers[0].status.message
        assert incarnations(machine) == before

        versions = {first: "before", second: "an hour later", third: "an hour earlier"}
        assert {version: noted(machine, version) for version in versions} == versions
        again = run_script("im", "run", "calibrate_camera", "--json", "--poses_file", poses)
        assert again.returncode == 0, again.stdout + again.stderr
        assert (names.results_dir() / "latest").resolve() == Path(json.loads(again.stdout)["directory"]).resolve()
        assert incarnations(machine) == before
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60.0) as page:
            assert page.status == 200
        tasks = run_script("im", "tasks", "--json")
        assert tasks.returncode == 0, tasks.stderr
        assert {task["phase"] for task in json.loads(tasks.stdout)} == {"ready"}
        record.send_signal(signal.SIGINT)
        assert record.wait(60.0) == 0, record.out.read_text()
    with BagReader(bag) as reader:
        logged = [logged_ns for _, logged_ns, _ in reader.messages(["/pnt/firings"])]
    assert len(logged) >= len(machine.firings) > 0
    assert logged == sorted(logged)
