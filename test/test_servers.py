"""Servers of a name in the graph of ROS: not those whose process has ended, whatever DDS still keeps."""

import os
import signal
import subprocess
import sys
from types import SimpleNamespace

import pytest
import rclpy

from im_core.errors import LinkError
from im_core.ros.node import ManagedNode
from im_core.ros.peers import servers
from im_core.ros.peers.servers import servers_of
from im_pnt_node.ros.execution import actions
from im_pnt_node.ros.execution.actions import Surroundings

SERVER = """
import rclpy
from std_srvs.srv import Trigger
rclpy.init()
node = rclpy.create_node("oven")
node.create_service(Trigger, "/bake", lambda request, response: response)
rclpy.spin(node)
"""


@pytest.fixture
def client(ros):
    node = ManagedNode("cook")
    ros(node)
    return node


@pytest.fixture
def server(client, wait_until):
    """A process with a server that the node has discovered."""
    with subprocess.Popen([sys.executable, "-c", SERVER]) as child:
        try:
            wait_until(lambda: servers_of(client, "/bake") == ["/oven"], "the server, and its name, which comes later")
            yield child
        finally:
            child.kill()


def test_a_killed_server_is_none_at_once_and_a_stopped_one_is_one(client, server):
    server.send_signal(signal.SIGSTOP)
    os.waitpid(server.pid, os.WUNTRACED)
    assert servers_of(client, "/bake") == ["/oven"]
    server.kill()
    os.waitid(os.P_PID, server.pid, os.WEXITED | os.WNOWAIT)  # nobody has fetched its end yet
    assert servers_of(client, "/bake") == []


@pytest.mark.parametrize("where", ["other host", "not DDS", "two of the number"])
def test_a_server_whose_process_is_not_certain_lives_as_long_as_dds_says(client, server, monkeypatch, where):
    (end,) = servers.server_ends(client, "/bake")
    monkeypatch.setattr(servers, "_processes", {})
    if where == "other host":
        end.endpoint_gid = [*end.endpoint_gid[:2], end.endpoint_gid[2] ^ 1, *end.endpoint_gid[3:]]
    elif where == "not DDS":
        monkeypatch.setattr(servers, "has_loaded", lambda pid, file: False)
    else:
        monkeypatch.setattr(servers, "processes_ending_in", lambda bits, size: [server.pid, os.getpid()])
    found = [end]
    monkeypatch.setattr(
        client, "get_subscriptions_info_by_topic", lambda topic, _: found if "/_action" in topic else []
    )
    assert servers_of(client, "/bake") == ["/oven"]
    server.kill()
    server.wait()
    assert servers_of(client, "/bake") == ["/oven"]


def test_an_answer_is_owed_by_the_server_that_was_asked_not_by_its_successor(client, monkeypatch, wait_until):
    monkeypatch.setattr(actions, "LOOK_S", 0.01)
    there, asked, told = [{b"first"}], [], []
    around = Surroundings(client, None, None, None, None)

    async def ask():
        try:
            server = SimpleNamespace(ends=lambda: asked.append(there[0]) or frozenset(there[0]))
            await around.wait(rclpy.task.Future(), None, 3600.0, "an answer", server)
        except LinkError as error:
            told.append(error.message)

    client.spawn(ask())
    wait_until(lambda: asked, "the wait")
    there[0] = {b"second"}
    wait_until(lambda: told, "the end of the wait")
    assert told == ["an answer will not come: the node that owes it is gone"]
