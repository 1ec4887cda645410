"""The record of a host: programs of the host reach the machine by it, while its process lives."""

import json
import os
import subprocess
import sys

import pytest

from im_core.processes import host_record
from im_core.processes.host_record import PROFILE, reach_machine

DDS = {PROFILE: "/there/fastdds_hosts.xml", "ROS_STATIC_PEERS": "10.0.0.1;127.0.0.1"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(host_record, "SHM", tmp_path)
    monkeypatch.setenv("ROS_DOMAIN_ID", "17")
    monkeypatch.delenv("ROS_STATIC_PEERS", raising=False)
    return tmp_path


@pytest.mark.parametrize("before", [None, "", "/here/fastdds.xml", "/elsewhere/fastdds_hosts.xml"])
def test_a_program_takes_the_profile_and_the_peers_of_the_machine(folder, monkeypatch, before):
    monkeypatch.delenv(PROFILE, raising=False)
    if before is not None:
        monkeypatch.setenv(PROFILE, before)
    host_record.write("far", True, folder / "far", DDS)
    reach_machine(18)
    assert os.environ.get(PROFILE) == before
    reach_machine()
    assert {name: os.environ[name] for name in DDS} == DDS
    assert host_record.read(17).run_dir == str(folder / "far")


def test_a_profile_of_the_user_is_kept(folder, monkeypatch):
    monkeypatch.setenv(PROFILE, "/mine/one_interface.xml")
    host_record.write("far", True, folder, DDS)
    reach_machine()
    assert os.environ[PROFILE] == "/mine/one_interface.xml"
    assert "ROS_STATIC_PEERS" not in os.environ


def test_the_record_of_a_dead_process_counts_for_nothing_and_stays_its_own(folder):
    code = """
import sys
from pathlib import Path
from im_core.processes import host_record
host_record.SHM = Path(sys.argv[1])
host_record.write("far", True, Path("/"), {})
assert host_record.read().is_agent
"""
    subprocess.run([sys.executable, "-c", code, folder], check=True)
    assert [path.name for path in folder.iterdir()] == ["im17_host.json"]
    assert host_record.read() is None
    host_record.remove()
    assert [path.name for path in folder.iterdir()] == ["im17_host.json"]


@pytest.mark.parametrize("text", ["", "[]", "{}", json.dumps({"pid": 1, "start": "x", "more": 2})])
def test_what_no_agent_has_written_is_no_record(folder, text):
    (folder / "im17_host.json").write_text(text)
    assert host_record.read() is None


def test_a_process_removes_its_record(folder):
    host_record.write("far", False, folder, {})
    host_record.remove()
    assert list(folder.iterdir()) == []
