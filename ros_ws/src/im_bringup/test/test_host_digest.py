"""Digests of hosts: equal where the hosts have the same, whatever the bootstrap has left out for the cell."""

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
