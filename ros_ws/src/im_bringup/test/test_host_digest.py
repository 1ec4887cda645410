"""Digests of hosts: equal where the hosts have the same, whatever the bootstrap has left out for the cell."""

import sys

import pytest

from im_bringup.tasks.deployment import Deployment, for_cell, load_parts
from im_bringup.tasks.host_digest import differences, digests


def deployment(cell):
    task = {"package": "a", "executable": "b"}
    tasks = {"dom": {**task, "node": "/dom"}, "eye": {**task, "node": "/eye", "needs": ["laser"]}}
    hosts = {host: {name: {name: tasks[name]}} for host, name in (("here", "dom"), ("far", "eye"))}
    return Deployment.model_validate({"hosts": hosts, "cell": cell})


def test_tasks_that_a_cell_lacks_parts_for_make_no_difference():
    whole = deployment("ur5")
    reduced = for_cell(whole, load_parts("ur5"))
    assert reduced.hosts["far"] == {}
    assert differences(digests(reduced), digests(whole)) == []


def test_another_cell_is_a_difference():
    assert differences(digests(deployment("ur5")), digests(deployment("panda"))) == ["cell"]


@pytest.fixture
def with_nets(tmp_path, monkeypatch):
    """Return a function that writes a net file of package ``a``, and returns the digests of the host."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "a/nets/parts").mkdir(parents=True)
    (tmp_path / "a/__init__.py").write_text("raise AssertionError('a digest imports no package')")

    def digests_with(name, text):
        (tmp_path / "a/nets" / name).write_text(text)
        return digests(deployment("ur5"))

    yield digests_with
    sys.modules.pop("a", None)


@pytest.mark.parametrize("name", ["pick.yaml", "parts/steps.yaml"])
def test_another_net_file_of_a_package_is_a_difference(with_nets, name):
    ours, same, theirs = (with_nets(name, text) for text in ("net: one", "net: one", "net: two"))
    assert differences(ours, same) == []
    assert differences(ours, theirs) == ["nets of a"]


def test_a_host_may_lack_a_package_of_the_other(with_nets):
    theirs = with_nets("pick.yaml", "net: one")
    assert "nets of a" in theirs
    assert differences({name: digest for name, digest in theirs.items() if name != "nets of a"}, theirs) == []


def test_free_bodies_of_one_host_alone_are_a_difference(monkeypatch, tmp_path):
    ours = digests(deployment("ur5"))
    (tmp_path / "bodies.yaml").write_text("objects: {}")
    monkeypatch.setenv("IM_OBJECTS", str(tmp_path / "bodies.yaml"))
    assert differences(ours, digests(deployment("ur5"))) == ["free bodies (IM_OBJECTS)"]
