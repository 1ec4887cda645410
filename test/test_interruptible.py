"""Programs that talk to the machine: what they print, and what ends their waits."""

import os
import signal
import subprocess
import sys
import threading

import pytest
from rclpy.task import Future
from std_srvs.srv import Trigger

from im import UnreachableError
from im_bringup.ros import interruptible
from im_bringup.ros.interruptible import InterruptibleNode, spun
from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.ros.guard import GuardedNode


def test_what_rclpy_prints_is_not_among_the_output_of_a_program(capfd, monkeypatch):
    """It warns on standard output of each timer beyond eight, as a program has that waits for long."""
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with spun(lambda: InterruptibleNode("talker")) as node:
        for _ in range(20):
            node.create_timer(10.0, lambda: None)
        clock.sleep(0.3)
        print('{"success": true}')
        print("Warning, the number of poses is small.")
    assert capfd.readouterr().out == '{"success": true}\nWarning, the number of poses is small.\n'


TALKS = """
import os, sys
from im_bringup.ros.interruptible import InterruptibleNode, spun
print("before")
with spun(lambda: InterruptibleNode("talker")):
    os.write(1, b"RTPS_TRANSPORT_SHM Error\\n")
    print("own")
os.write(1, b"after\\n")
"""


def test_what_libraries_print_is_not_among_the_output_of_a_program():
    """Fast DDS prints its errors on standard output: a report was no JSON any more."""
    said = subprocess.run([sys.executable, "-c", TALKS], capture_output=True, text=True, check=True)
    assert said.stdout == "before\nown\nafter\n"
    assert "RTPS_TRANSPORT_SHM Error" in said.stderr


SAYS = """
import sys
from im_bringup.ros import interruptible
interruptible.runs_here = lambda: True
def use(node):
    print("one", flush=True)
    print("two")
    print("waited to the end", file=sys.stderr)
    return 0
sys.exit(interruptible.talk(lambda: interruptible.InterruptibleNode("talker"), use, "talker"))
"""
NO_ROOM = "talker: standard output cannot be written: No space left on device\n"


@pytest.mark.parametrize(
    ("where", "code", "said"),
    [("| true", 0, ""), (">&-", 0, ""), ("> /dev/full", 1, NO_ROOM)],
    ids=["no reader", "closed", "full disk"],
)
def test_a_program_whose_output_goes_nowhere_waits_all_the_same(where, code, said):
    """And says in a sentence where something was lost that somebody wanted."""
    run = ["bash", "-c", f'set -o pipefail; "$0" -c "$1" {where}', sys.executable, SAYS]
    done = subprocess.run(run, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (code, f"waited to the end\n{said}")


@pytest.mark.parametrize("here", [True, False])
def test_a_machine_is_one_of_this_host_or_one_in_the_graph(ros, monkeypatch, here):
    asking = ros(InterruptibleNode("asking"))
    monkeypatch.setattr(interruptible, "runs_here", lambda: here)
    monkeypatch.setattr(asking, "get_node_names", lambda: [] if here else ["bootstrap"])
    asking.require_machine()


def test_a_machine_that_is_neither_here_nor_in_the_graph_is_looked_for_in_vain(ros, monkeypatch):
    asking = ros(InterruptibleNode("asking"))
    monkeypatch.setattr(interruptible, "LOOKED_FOR_S", 0.1)
    monkeypatch.setattr(interruptible, "runs_here", lambda: False)
    monkeypatch.setattr(asking, "get_node_names", lambda: ["talker"])
    with pytest.raises(UnreachableError, match=r"no machine runs in ROS domain \d+: none was heard within 0.1 s"):
        asking.require_machine()


def test_who_waits_for_a_service_ends_when_interrupted(ros):
    """Neither for a service that is not there, nor for one that is silent, a program waits after Ctrl-C."""
    asking, silent = InterruptibleNode("asking"), GuardedNode("silent")

    async def never(request, response):
        await Future()

    silent.create_service(Trigger, "/silent/answer", never)
    ros(asking, silent)
    for service in ("/nobody/answers", "/silent/answer"):
        client = asking.create_client(Trigger, service)
        with pytest.raises(WaitTimeoutError, match=service):
            asking.ask(client, Trigger.Request(), 0.5)
    threading.Timer(0.3, asking.interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        asking.ask(client, Trigger.Request(), 60.0)
    with pytest.raises(KeyboardInterrupt):
        asking.pause(60.0)


@pytest.mark.parametrize("variable", ["ROS_SECURITY_KEYSTORE", "ROS_LOG_DIR"])
def test_what_ros_refuses_is_one_sentence_of_a_client_and_of_a_node(variable, tmp_path):
    """Without a traceback: security without keys, and a folder of logs that cannot be made."""
    (tmp_path / "file").touch()
    security = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"}
    given = {**os.environ, variable: str(tmp_path / "file/folder"), **(security if "KEY" in variable else {})}
    for program, begins in (("im_bringup.ros.tasks", "im tasks: ROS "), ("im_dom.ros.node", "ROS ")):
        argv = [sys.executable, "-m", program]
        done = subprocess.run(argv, env=given, capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert done.stderr.splitlines()[-1].startswith(begins)
        assert "Traceback" not in done.stderr
