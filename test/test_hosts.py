"""Who is on another host and who is not: two network namespaces, joined by a cable, stand for two computers."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest

from im_bringup.tasks.middleware import PROFILE, loopback_profile, open_profile
from im_core.config import package_file
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


class Host:
    """A network of its own, and a shared memory of its own.

    Args:
        stack: Ends what runs here.
        address: In the network that joins the hosts.
    """

    def __init__(self, stack, address):
        self.address = address
        argv = ["unshare", "--net", "--mount", "sh", "-c", "mount -t tmpfs tmpfs /dev/shm && echo && exec sleep 3600"]
        try:
            self._holder = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        except FileNotFoundError:
            pytest.skip("there is no command unshare")
        stack.callback(self._holder.communicate)
        stack.callback(self._holder.kill)
        if not self._holder.stdout.readline():
            pytest.skip(f"no namespaces here: {self._holder.stderr.readline().decode().strip()}")
        self.pid = self._holder.pid
        self._stack = stack

    def argv(self, *argv):
        return ["nsenter", "--target", str(self.pid), "--net", "--mount", *map(str, argv)]

    def run(self, *argv, **environment):
        """Run a command to its end."""
        settings = {"capture_output": True, "text": True, "check": False, "timeout": 10 * WAIT_S}
        return subprocess.run(self.argv(*argv), env=environment_with(environment), **settings)

    def start(self, *argv, **environment):
        """Start a process, which ends with the test."""
        process = subprocess.Popen(self.argv(*argv), env=environment_with(environment), stdout=subprocess.DEVNULL)
        self._stack.callback(process.wait)
        self._stack.callback(process.kill)
        return process

    def look(self, seconds, *settings):
        """What clients find here that were not told anything by our scripts: one for each environment, all at once."""
        with ThreadPoolExecutor() as pool:
            looks = [pool.submit(self.run, sys.executable, "-c", CLIENT, seconds, **each) for each in settings]
        for done in (look.result() for look in looks):
            assert done.returncode == 0, done.stderr
        return [json.loads(look.result().stdout) for look in looks]

    def ports(self, protocol):
        """Addresses and ports of the sockets of this host, and the state of each."""
        for line in Path(f"/proc/{self.pid}/net/{protocol}").read_text().splitlines()[1:]:
            _, local, _, state, *_ = line.split()
            address, port = local.split(":")
            yield address, int(port, 16), state


def environment_with(changes):
    """The environment without what our scripts say of DDS."""
    plain = {key: value for key, value in os.environ.items() if key not in (PROFILE, "ROS_AUTOMATIC_DISCOVERY_RANGE")}
    return {**plain, **changes}


def connected(stack, wait_until, count):
    """Make hosts whose cables meet in a switch, which is in a network of its own."""
    switch = Host(stack, "")
    hosts = [Host(stack, f"10.99.7.{number}") for number in range(1, count + 1)]
    commands = [switch.argv("ip", "link", "add", "switch", "type", "bridge")]
    commands.append(switch.argv("ip", "link", "set", "switch", "up"))
    for number, host in enumerate(hosts, start=1):
        plug = f"port{number}"
        commands.append(f"ip link add eth7 netns {host.pid} type veth peer name {plug} netns {switch.pid}".split())
        commands.append(switch.argv("ip", "link", "set", plug, "master", "switch"))
        commands.append(switch.argv("ip", "link", "set", plug, "up"))
        up = (f"addr add {host.address}/24 dev eth7", "link set lo up", "link set eth7 up")
        commands.extend(host.argv("ip", *rest.split()) for rest in up)
    for command in commands:
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except FileNotFoundError:
            pytest.skip(f"there is no command {command[0]}")
        if done.returncode:
            pytest.skip(f"no network between namespaces here: {done.stderr.strip()}")
    for host in hosts:  # DDS takes the interfaces that are up when it begins
        wait_until(lambda host=host: "state UP" in host.run("ip", "link", "show", "eth7").stdout, "the cable")
    return hosts


@pytest.fixture
def hosts(wait_until):
    """Two hosts that reach each other."""
    with ExitStack() as stack:
        yield connected(stack, wait_until, 2)


@pytest.fixture
def three(wait_until):
    """Three hosts that reach each other."""
    with ExitStack() as stack:
        yield connected(stack, wait_until, 3)


def neighbours(host):
    """How a client of another host asks for the machine of a host, in the two ways there are."""
    return [
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": reach, "ROS_STATIC_PEERS": host.address} for reach in ("LOCALHOST", "SUBNET")
    ]


def listens_on_loopback_alone(host, processes):
    """Whether the sockets that DDS receives with, and those that wait for connections, are on the loopback."""
    first = 7400 + 250 * int(os.environ["ROS_DOMAIN_ID"])
    receiving = [(address, port) for address, port, _ in host.ports("udp") if first <= port < first + 250]
    assert len(receiving) >= 2 * processes, receiving
    receiving += [(address, port) for address, port, state in host.ports("tcp") if state == "0A"]
    elsewhere = [entry for entry in receiving if entry[0] != "0100007F"]
    return not elsewhere and not [entry for entry in host.ports("tcp6") if entry[2] == "0A"]


@pytest.mark.parametrize("several", [False, True], ids=["one host", "several hosts"])
def test_a_node_is_reached_from_another_host_only_where_it_is_opened(hosts, several):
    here, there = hosts
    profile = open_profile() if several else loopback_profile()
    settings = {PROFILE: str(profile), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    here.start(sys.executable, "-m", "im_dom.ros.node", "--ros-args", "-p", "standalone:=true", **settings)
    # a client of this host needs nothing of ours
    plain = [{"ROS_AUTOMATIC_DISCOVERY_RANGE": reach} for reach in ("LOCALHOST", "SUBNET")]
    assert all(found["answered"] for found in here.look(WAIT_S, *plain, {"FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}))
    assert listens_on_loopback_alone(here, 1) is not several
    for found in there.look(WAIT_S if several else LOOK_S, *neighbours(here)):
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
    """Name, host, state and reason of each task, as ``im tasks`` tells on a host."""
    done = host.run(sys.executable, "-m", "im_bringup.ros.tasks", "--json")
    assert done.returncode == 0, done.stderr
    return [(task["name"], task["host"], task["phase"], task["detail"]) for task in json.loads(done.stdout)]


def test_a_deployment_over_two_hosts_opens_itself_and_survives_a_cut_cable(two, wait_until):
    """The file alone decides: neither the terminal of the start nor that of the agent says anything of DDS."""
    here, there, deployment = two
    agent = there.start(*START, deployment, "--host", "far")
    done = here.run(*START, deployment, "--timeout", 3 * WAIT_S)
    assert done.returncode == 0, done.stderr
    assert "DDS listens on all interfaces, for hosts localhost, far (docs/security.md)" in done.stdout
    assert [task[:3] for task in tasks_of(here)] == [
        ("dom", "localhost", "ready"),
        ("gripper_coordinator", "far", "ready"),
    ]
    there.run("ip", "link", "set", "eth7", "down")
    vanished = "nothing was heard of host far for "
    wait_until(lambda: tasks_of(here)[1][2:] == ("dead", tasks_of(here)[1][3]), "the host to be missed", 6 * WAIT_S)
    assert tasks_of(here)[1][3].startswith(vanished)
    there.run("ip", "link", "set", "eth7", "up")
    wait_until(lambda: tasks_of(here)[1][2] == "ready", "the host to come back", 6 * WAIT_S)
    assert here.run(*STOP).returncode == 0
    assert agent.wait(WAIT_S) == 0


def test_a_host_without_an_agent_is_named_with_the_line_that_is_missing_there(two):
    here, _, deployment = two
    done = here.run(*START, deployment, "--timeout", 8)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "start: not every task was ready after 8 s:",
        "  host far: no agent was heard; on it: start.sh FILE --host far",
    ]


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
    settings = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    done = here.run(sys.executable, *start, "--factor", 0, "--timeout", 5 * WAIT_S, **settings)
    try:
        assert done.returncode == 0, done.stderr
        assert here.look(WAIT_S, {})[0]["answered"]
        assert listens_on_loopback_alone(here, 5)
        assert there.look(2 * LOOK_S, *neighbours(here)) == [NOBODY, NOBODY]
    finally:
        assert here.run(sys.executable, *stop, **settings).returncode == 0
