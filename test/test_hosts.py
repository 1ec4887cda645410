"""Who is on another host and who is not: two network namespaces, joined by a cable, stand for two computers."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from bench.chaos.hosts import connected
from im_bringup.ros.security import enclaves_of
from im_bringup.tasks.middleware import RANGE, loopback_profile, open_profile
from im_core.config import package_file
from im_core.errors import StateError
from im_core.processes.host_record import PROFILE
from support.whole_machine import write_few_poses

WAIT_S = 60.0
#: How long a stranger looks for a machine that it must not find [s]; the one that it may find takes a second.
LOOK_S = 5.0

CLIENT = """
import json, sys
import rclpy
from im_msgs.srv import PutObject
rclpy.init(args=[])
node = rclpy.create_node("stranger")
client = node.create_client(PutObject, "/dom/put")
answered = False
if client.wait_for_service(timeout_sec=float(sys.argv[1])):
    future = client.call_async(PutObject.Request(name="from_outside"))
    rclpy.spin_until_future_complete(node, future, timeout_sec=float(sys.argv[1]))
    answered = future.done()
names = [name for name in node.get_node_names() if name != "stranger"]
topics = [name for name, _ in node.get_topic_names_and_types() if name not in ("/rosout", "/parameter_events")]
own = ("/stranger/", "/dom/put")  # a client counts as a name, too
services = [name for name, _ in node.get_service_names_and_types() if not name.startswith(own)]
print(json.dumps({"answered": answered, "nodes": names, "topics": topics, "services": services}))
"""
NAMES = ("localhost", "coordination", "display")
NOBODY = {"answered": False, "nodes": [], "topics": [], "services": []}


def look(host, seconds, *settings):
    """What clients find on a host that were not told anything by our scripts: one for each environment, all at once."""
    with ThreadPoolExecutor() as pool:
        looks = [pool.submit(host.run, sys.executable, "-c", CLIENT, seconds, **each) for each in settings]
    for done in (each.result() for each in looks):
        assert done.returncode == 0, done.stderr
    return [json.loads(each.result().stdout) for each in looks]


def ports(host, protocol):
    """Addresses and ports of the sockets of a host, and the state of each."""
    for line in Path(f"/proc/{host.pid}/net/{protocol}").read_text().splitlines()[1:]:
        _, local, _, state, *_ = line.split()
        address, port = local.split(":")
        yield address, int(port, 16), state


@pytest.fixture
def hosts():
    """Two hosts that reach each other."""
    with connected(2) as network:
        yield network.hosts


@pytest.fixture
def three():
    """Three hosts that reach each other."""
    with connected(3) as network:
        yield network.hosts


def neighbours(host):
    """How a client of another host asks for the machine of a host, in the two ways there are."""
    return [{RANGE: reach, "ROS_STATIC_PEERS": host.address} for reach in ("LOCALHOST", "SUBNET")]


def listens_on_loopback_alone(host, processes):
    """Whether the sockets that DDS receives with, and those that wait for connections, are on the loopback."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    receiving = [(address, port) for address, port, _ in ports(host, "udp") if first <= port < first + 250]
    assert len(receiving) >= 2 * processes, receiving
    receiving += [(address, port) for address, port, state in ports(host, "tcp") if state == "0A"]
    elsewhere = [entry for entry in receiving if entry[0] != "0100007F"]
    return not elsewhere and not [entry for entry in ports(host, "tcp6") if entry[2] == "0A"]


@pytest.mark.parametrize("several", [False, True], ids=["one host", "several hosts"])
def test_a_node_is_reached_from_another_host_only_where_it_is_opened(hosts, several):
    here, there = hosts
    profile = open_profile() if several else loopback_profile()
    settings = {PROFILE: str(profile), RANGE: "SUBNET"}
    here.start(sys.executable, "-m", "im_dom.ros.node", "--ros-args", "-p", "standalone:=true", **settings)
    # a client of this host needs nothing of ours
    plain = [{RANGE: reach} for reach in ("LOCALHOST", "SUBNET")]
    assert all(found["answered"] for found in look(here, WAIT_S, *plain, {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}))
    assert listens_on_loopback_alone(here, 1) is not several
    for found in look(there, WAIT_S if several else LOOK_S, *neighbours(here)):
        if several:
            assert found["answered"]
            assert "/dom/get" in found["services"]
        else:
            assert found == NOBODY


TWO_HOSTS = """\
addresses: {localhost: 10.99.7.1, far: 10.99.7.2}
hosts:
  localhost:
    dom:
      dom: {package: im_dom, executable: dom, node: /dom}
  far:
    gripper_coordinator:
      gripper_coordinator: {package: im_coordinators, executable: gripper_coordinator, node: /gripper_coordinator}
"""
START = (sys.executable, "-m", "im_bringup.machine.start")
STOP = (sys.executable, "-m", "im_bringup.machine.stop")


@pytest.fixture
def two(hosts, tmp_path):
    """Two hosts and a deployment over both; a machine on them is stopped."""
    deployment = tmp_path / "two.yaml"
    deployment.write_text(TWO_HOSTS)
    here, there = hosts
    yield here, there, deployment
    here.run(*STOP)


def tasks_of(host):
    """What ``im tasks`` tells on a host of each task, by name."""
    done = host.run(sys.executable, "-m", "im_bringup.ros.tasks", "--json")
    assert done.returncode == 0, done.stderr
    return {task["name"]: task for task in json.loads(done.stdout)}


KILL_PARENT = """
import os, pathlib, sys
(parent,) = (line.split()[1] for line in pathlib.Path(f"/proc/{sys.argv[1]}/status").open() if line[:5] == "PPid:")
assert f"agent\\0far\\0".encode() in pathlib.Path(f"/proc/{parent}/cmdline").read_bytes()
os.kill(int(parent), 9)
"""


def test_a_deployment_over_two_hosts_opens_itself_and_survives_a_cut_cable_and_the_death_of_an_agent(two, wait_until):
    """The file alone decides: neither the terminal of the start nor that of the agent says anything of DDS."""
    here, there, deployment = two

    def far():
        return tasks_of(here)["gripper_coordinator"]

    agent = there.start(*START, deployment, "--host", "far")
    done = here.run(*START, deployment, "--timeout", 3 * WAIT_S)
    assert done.returncode == 0, done.stderr
    assert "DDS listens on all interfaces, for hosts localhost, far (docs/security.md)" in done.stdout
    assert {name: (task["host"], task["phase"]) for name, task in tasks_of(here).items()} == {
        "dom": ("localhost", "ready"),
        "gripper_coordinator": ("far", "ready"),
    }
    there.cable(up=False)
    wait_until(lambda: far()["phase"] == "dead", "the host to be missed", 6 * WAIT_S)
    assert far()["detail"].startswith("nothing was heard of host far for ")
    there.cable(up=True)
    before = wait_until(lambda: (task := far())["phase"] == "ready" and task, "the host to come back", 6 * WAIT_S)

    assert there.run(sys.executable, "-c", KILL_PARENT, before["pid"]).returncode == 0

    def again():
        return (task := far())["phase"] == "ready" and task["incarnation"] != before["incarnation"]

    wait_until(again, "another agent to start the task again", 6 * WAIT_S)
    assert here.run(*STOP).returncode == 0
    assert agent.wait(WAIT_S) == 0


SCRIPTS = Path(__file__).parents[1] / "scripts"


def test_programs_of_each_host_reach_the_other_and_a_stop_ends_what_runs_on_its_host(two, wait_until):
    """What a user types, with the environment of scripts: on one host alone it keeps DDS to the loopback."""
    here, there, deployment = two
    agent = there.start(SCRIPTS / "start.sh", deployment, "--host", "far")
    done = here.run(SCRIPTS / "start.sh", deployment, "--timeout", 3 * WAIT_S)
    assert done.returncode == 0, done.stderr
    for host in (here, there):
        done = host.run(SCRIPTS / "im", "tasks", "--json")
        assert [task["phase"] for task in json.loads(done.stdout)] == ["ready", "ready"], done.stderr
        for node in ("dom", "gripper_coordinator"):
            done = host.run(SCRIPTS / "im", "param", "get", f"/{node}", "use_sim_time")
            assert done.returncode == 0, done.stdout + done.stderr
    done = there.run(SCRIPTS / "im", "view")
    assert done.returncode == 3
    assert done.stderr.startswith("im view: host far serves no page; ")
    for refused in ((), ("--host", "far")):
        done = there.run(SCRIPTS / "start.sh", deployment, *refused)
        assert done.returncode == 1
        assert done.stderr.startswith("start: the agent of host far of ROS domain ")
    done = there.run(SCRIPTS / "stop.sh")
    assert done.returncode == 0
    first, second = done.stdout.splitlines()
    assert first.startswith("stop: the agent of host far ends with its tasks; ")
    assert second.startswith("stop: all tasks ended in order; ")
    assert agent.wait(WAIT_S) == 0
    wait_until(lambda: tasks_of(here)["gripper_coordinator"]["phase"] == "dead", "the host to be missed", 6 * WAIT_S)
    assert here.run(SCRIPTS / "stop.sh").returncode == 0


def test_a_start_on_a_third_host_leaves_a_running_machine_its_agent(three, tmp_path):
    here, there, elsewhere = three
    deployment = tmp_path / "two.yaml"
    deployment.write_text(TWO_HOSTS)
    agent = there.start(*START, deployment, "--host", "far")
    done = here.run(*START, deployment, "--timeout", 3 * WAIT_S)
    try:
        assert done.returncode == 0, done.stderr
        before = {name: task["incarnation"] for name, task in tasks_of(here).items()}
        done = elsewhere.run(*START, deployment, "--timeout", 3 * WAIT_S)
        assert done.returncode == 1
        told = done.stderr.splitlines()
        assert told[0] == "start: not every task could be started:"
        assert told[1].startswith(
            "  the agent of host far works for a machine of the same ROS domain on another host ("
        )
        assert {name: task["incarnation"] for name, task in tasks_of(here).items()} == before
        assert [task["phase"] for task in tasks_of(here).values()] == ["ready", "ready"]
    finally:
        assert here.run(*STOP).returncode == 0
    assert agent.wait(WAIT_S) == 0


MISSING = "from im_bringup.machine import machine_state; print(*machine_state.read().missing, sep='\\n')"


def test_an_agent_without_a_link_is_missed_with_the_line_for_its_host_and_comes_with_the_link(two, wait_until):
    here, there, deployment = two
    there.cable(up=False)
    agent = there.start(*START, deployment, "--host", "far")
    with ThreadPoolExecutor() as pool:
        start = pool.submit(here.run, *START, deployment, "--timeout", 5 * WAIT_S)

        def missing():
            return here.run(sys.executable, "-c", MISSING).stdout.splitlines()[:1]

        named = ["host far: no agent was heard; on it: start.sh FILE --host far"]
        wait_until(lambda: missing() == named, "the host to be named", 3 * WAIT_S)
        there.cable(up=True)
        done = start.result()
    assert done.returncode == 0, done.stderr
    assert here.run(*STOP).returncode == 0
    assert agent.wait(WAIT_S) == 0


def test_a_host_with_another_cell_or_other_tasks_is_named_and_gets_no_orders(two, tmp_path):
    here, there, deployment = two
    cell, shipped = tmp_path / "cell.yaml", package_file("im_cell", "cells/puma_pair/cell.yaml")
    robot = (shipped.parent / "puma_pair.urdf").read_text()
    assert 'upper="0.85"' in robot
    (tmp_path / "puma_pair.urdf").write_text(robot.replace('upper="0.85"', 'upper="0.86"', 1))
    cell.write_text(shipped.read_text())
    other = tmp_path / "other.yaml"
    other.write_text(f"cell: {cell}\n{TWO_HOSTS.replace('gripper_', 'motion_')}")
    there.start(*START, other, "--host", "far")
    done = here.run(*START, deployment, "--timeout", 3 * WAIT_S)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "start: not every task could be started:",
        "  host far differs from host localhost in: cell, tasks of the deployment file; give both the same files",
    ]


def test_a_task_that_dies_on_another_host_is_told_with_its_last_words(two):
    here, there, deployment = two
    dies = "    doctor:\n      doctor: {package: im_bringup, executable: doctor, node: /doctor}\n"
    deployment.write_text(TWO_HOSTS + dies)
    there.start(*START, deployment, "--host", "far")
    done = here.run(*START, deployment, "--timeout", WAIT_S)
    assert done.returncode == 1
    assert "  doctor died: it ended with exit code 2: " in done.stderr
    assert "unrecognized arguments: --ros-args" in done.stderr


def test_enclaves_are_of_the_hosts_that_are_there():
    tasks = [{"node": f"/{name}", "host": name, "process": f"{name}_process"} for name in ("b", "c", "a")]
    assert enclaves_of(tasks, {"/agent_c", "/agent_a", "/bootstrap"}) == {
        "/a": "/im/a/a_process",
        "/b": "/im/b/b_process",
        "/c": "/im/c/c_process",
        "/bootstrap": "/im/b/bootstrap",
        "/agent_a": "/im/a/agent",
        "/agent_c": "/im/c/agent",
    }
    with pytest.raises(StateError, match="of the hosts a, b one runs the bootstrap; of the others no agent runs"):
        enclaves_of(tasks, {"/agent_c", "/bootstrap"})


@pytest.mark.end_to_end
def test_cameras_are_calibrated_over_three_hosts_and_a_command_is_given_from_each(three, tmp_path):
    cell, coordination, display = three
    shipped = (package_file("im_bringup", "deployments/three_hosts.yaml")).read_text()
    addresses = ", ".join(f"{name}: {host.address}" for name, host in zip(NAMES, three, strict=True))
    deployment = tmp_path / "three.yaml"
    deployment.write_text(f"addresses: {{{addresses}}}\n{shipped}")
    agents = [host.start(*START, deployment, "--host", name) for host, name in zip(three[1:], NAMES[1:], strict=True)]
    done = cell.run(*START, deployment, "--factor", 0, "--timeout", 5 * WAIT_S)
    try:
        assert done.returncode == 0, done.stderr
        run = (sys.executable, "-m", "im_bringup.ros.run_command")
        done = coordination.run(*run, "calibrate_camera", "--poses_file", write_few_poses(tmp_path))
        assert done.returncode == 0, done.stdout + done.stderr
        there = {PROFILE: str(open_profile()), "ROS_STATIC_PEERS": coordination.address}
        done = display.run(*run, "home", **there)
        assert done.returncode == 0, done.stdout + done.stderr
    finally:
        assert cell.run(*STOP).returncode == 0
    assert [agent.wait(WAIT_S) for agent in agents] == [0, 0]


def test_options_of_the_machine_are_refused_at_an_agent():
    for given in (("--seed", "3"), ("--control",), ("--foreground",)):
        done = subprocess.run([*START, "--host", "far", *given], capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert f"{given[0]} is given at the start on the first host" in done.stderr


@pytest.mark.end_to_end
def test_no_other_host_sees_or_calls_anything_of_a_whole_machine(hosts):
    here, there = hosts
    start, stop = (["-m", f"im_bringup.machine.{name}"] for name in ("start", "stop"))
    settings = {RANGE: "LOCALHOST"}
    done = here.run(sys.executable, *start, "--factor", 0, "--timeout", 5 * WAIT_S, **settings)
    try:
        assert done.returncode == 0, done.stderr
        assert look(here, WAIT_S, {})[0]["answered"]
        assert listens_on_loopback_alone(here, 5)
        assert look(there, 2 * LOOK_S, *neighbours(here)) == [NOBODY, NOBODY]
    finally:
        assert here.run(sys.executable, *stop, **settings).returncode == 0
