"""Commands and waits of the client: followed through the death of the Dispatcher, interrupted, refused."""

import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from rclpy.action.client import ActionClient
from rclpy.action.server import CancelResponse, GoalResponse
from rclpy.parameter import Parameter
from rclpy.signals import uninstall_signal_handlers
from rclpy.task import Future
from std_msgs.msg import String

from im import Command, CommandFailedError, Machine, MachineError, UnreachableError
from im.commands import Progress
from im.groups import Group
from im.messages import message_of
from im_core import clock
from im_core.processes.startup import STATUS_TOPIC
from im_core.ros import qos
from im_core.ros.guard import GuardedActionServer, GuardedNode
from im_core.ros.node import ManagedNode
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState, NetDescription, TaskStatus
from im_msgs.srv import ControlCommand, ListCommands, LoadNet, Snap
from support.forgetful import forget
from support.loop import in_loop

RESULTS = {"directory": "/results/1"}


class Dispatcher(GuardedNode):
    """A dispatcher as clients see it, which a test lets forget what it was asked."""

    def __init__(self) -> None:
        super().__init__("dispatcher")
        self.begun, self.attached, self.numbers = [], [], [3]  # of which the first was an older command
        self.incarnation, self.cancelled, self.open = 7, [], []
        self.silent, self.phase = False, TaskStatus.READY
        self._status = self.create_publisher(TaskStatus, STATUS_TOPIC, qos.LATCHED)
        self.create_timer(0.1, self._beat)
        self.create_service(ListCommands, "/dispatcher/list_commands", self._list)
        GuardedActionServer(
            self, ExecuteCommand, "/dispatcher/execute", self._do,
            goal_callback=self._accept, cancel_callback=self._may_cancel,
        )  # fmt: skip

    def beat(self, incarnation):
        self._status.publish(TaskStatus(name="dispatcher", incarnation=incarnation, phase=self.phase))

    def _beat(self):
        if not self.silent:
            self.beat(self.incarnation)

    def _list(self, request, response):
        response.last = self.numbers[-1]
        response.commands = [CommandState(command_id=number, symbol=symbol) for number, symbol in self.open]
        return response

    def _may_cancel(self, handle):
        self.cancelled.append(handle.request.attach)
        return CancelResponse.ACCEPT

    def _accept(self, goal):
        self.begun.append(goal)
        return GoalResponse.ACCEPT

    async def _do(self, handle):
        if handle.request.attach:
            self.attached.append(handle.request.command_id)
        handle.succeed()
        return ExecuteCommand.Result(success=True, results=json.dumps(RESULTS))


class Dying(Dispatcher):
    """Never ends what it begins."""

    async def _do(self, handle):
        self.numbers.append(self.numbers[-1] + (not handle.request.attach))
        return await Future()


@pytest.fixture
def machine(ros):
    """``machine(node)``: a client connected to what stands for the machine."""
    connected = []

    def connect(node, **options):
        ros(node)
        connected.append(Machine.connect(timeout=30.0, **options))
        return connected[-1]

    yield connect
    for each in connected:
        each.close()


def test_a_client_hears_the_last_heartbeat_of_a_task_and_waits_for_no_other(ros, wait_until):
    task = ManagedNode("dispatcher", parameter_overrides=[Parameter("standalone", value=True)])
    ros(task)
    wait_until(lambda: task.ready, "the task")
    in_loop(task, task._heartbeat.cancel)
    with Machine.connect(timeout=30.0) as client:
        assert client.tasks == {"dispatcher": TaskStatus.READY}


def test_a_step_and_the_words_that_it_tells_at_once_are_one_line():
    command = Command.__new__(Command)
    command._told = queue.SimpleQueue()
    for step, message in (("go", ""), ("walk", ""), ("walk", "to the door"), ("walk", "through it"), ("back", "")):
        command._told.put(Progress(command, 0.5, step, message, "running"))
    command._told.put(None)
    told = [str(each) for each in command.progress()]
    assert told == [f"[ 50 %] {words}" for words in ("go", "to the door", "through it", "back")]
    assert list(command.progress()) == [], "the end is told again"


class Walking(Dispatcher):
    """Tells the number of a command first, and then its step, as the Dispatcher does; again until it was heard."""

    def __init__(self) -> None:
        super().__init__()
        self.heard = threading.Event()

    async def _do(self, handle):
        over = Future()

        def tell():
            for step in ("", "walk"):
                told = ExecuteCommand.Feedback(command_id=4, progress=-1.0, step=step, state="running")
                handle.publish_feedback(told)
            if self.heard.is_set() and not over.done():
                over.set_result(None)

        telling = self.create_timer(0.05, tell)
        await over
        telling.cancel()
        return await super()._do(handle)


def test_who_prints_the_progress_prints_no_empty_line(machine):
    dispatcher = Walking()
    told = []
    for progress in machine(dispatcher).run("go", wait=False):
        told.append(str(progress))
        dispatcher.heard.set()
    assert set(told) == {"walk"}


class Loading(Dispatcher):
    """Refuses each net at a place of its text."""

    def __init__(self) -> None:
        super().__init__()
        self.create_service(LoadNet, "/dispatcher/load_net", self._refuse)

    def _refuse(self, request, response):
        self.sent = dict(zip(request.included, request.included_yaml, strict=True))
        response.message = "net:3:5: places.net:1:2: there is no such thing, used in net:7:1"
        return response


def test_a_net_that_is_refused_is_named_by_its_file(machine, tmp_path):
    im, file = machine(Loading()), tmp_path / r"a\1.yaml"
    file.write_text("net: a")
    for given, named in ((file, file), ("net: a\n", "net")):
        with pytest.raises(MachineError) as caught:
            im.load_net(given)
        assert caught.value.message == f"{named}:3:5: places.net:1:2: there is no such thing, used in {named}:7:1"


def test_a_net_file_is_sent_with_the_files_that_it_includes(machine, tmp_path):
    dispatcher = Loading()
    im, file = machine(dispatcher), tmp_path / "a.yaml"
    file.write_text("net: a\ninclude: [sub/b.yaml, none.yaml]\n")
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "b.yaml").write_text("include: ../c.yaml\n")
    (tmp_path / "c.yaml").write_text("include: [a.yaml, sub/b.yaml]\n")
    with pytest.raises(MachineError):
        im.load_net(file)
    assert dispatcher.sent == {each: (tmp_path / each).read_text() for each in ("sub/b.yaml", "c.yaml", "a.yaml")}
    (tmp_path / "c.yaml").write_bytes(b"\xff")
    with pytest.raises(MachineError, match=r"^net file .*c\.yaml:1:1: is not UTF-8 text"):
        im.load_net(file)


@pytest.mark.parametrize(
    ("opened", "why"),
    [
        ([], "the dispatcher stopped before it recorded command calibrate_camera; run the command again"),
        ([(7, "home")], "the dispatcher stopped before it recorded command calibrate_camera; run the command again"),
        ([(7, "calibrate_camera"), (9, "calibrate_camera")], "this calibrate_camera is one of the commands 7, 9"),
    ],
)
def test_what_another_command_has_found_is_not_the_answer_to_this_one(machine, wait_until, opened, why):
    """The last calibration that has ended may be of another day."""

    class Stopped(Dispatcher):
        async def _do(self, handle):
            return await Future()

    command = machine(node := Stopped()).calibrate_camera()
    wait_until(lambda: node.begun, "the command")
    clock.sleep(1.0)  # until it is known to be accepted
    node.numbers, node.open, node.incarnation = [3, *(number for number, _ in opened)], opened, 8
    with pytest.raises(MachineError, match=why):
        _ = command.result
    assert not node.attached


def test_a_cancellation_reaches_the_incarnation_that_goes_on_with_the_command(machine, wait_until):
    """The first one died with it."""
    command = machine(node := Dying()).run("move", wait=False)
    wait_until(lambda: node.begun, "the command")
    clock.sleep(1.0)  # until it is known to be accepted
    command.cancel()
    wait_until(lambda: node.cancelled == [False], "the cancellation")
    node.incarnation = 8
    wait_until(lambda: node.cancelled == [False, True], "the cancellation of what the second life goes on with")
    assert not command.ended


def test_an_interrupt_cancels_and_a_second_one_leaves_the_command_alone(machine, wait_until):
    command = machine(node := Dying()).run("move", wait=False)
    wait_until(lambda: node.begun, "the command")

    def interrupt_twice():
        os.kill(os.getpid(), signal.SIGINT)
        wait_until(lambda: node.cancelled, "the cancellation")
        os.kill(os.getpid(), signal.SIGINT)

    uninstall_signal_handlers()  # else the node of this test would end
    threading.Timer(0.5, interrupt_twice).start()
    with pytest.raises(KeyboardInterrupt):
        command.wait()
    assert command.cancelling
    assert not command.ended


def test_im_run_ends_in_words_however_often_it_is_interrupted(ros, wait_until):
    """Ctrl-C in a terminal reaches a script and its client, and the script passes it on: all of it comes twice."""
    ros(node := Dying())
    argv = [sys.executable, "-m", "im_bringup.ros.run_command", "--attach", str(node.numbers[0])]
    with subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: node.begun, "the command")
        for _ in range(3000):
            process.send_signal(signal.SIGINT)
            process.send_signal(signal.SIGTERM)
            time.sleep(0.01)
            if process.poll() is not None:
                break
        process.kill()
        said = process.communicate(timeout=30.0)[1]
    assert process.returncode == 130, said
    assert "no longer waiting; the machine goes on" in said
    assert "Traceback" not in said, said
    assert said.count("\n") == 2, "each thing is said once"


def test_one_interruption_that_comes_twice_at_once_cancels_the_command(ros, wait_until):
    ros(node := Dying())
    argv = [sys.executable, "-m", "im_bringup.ros.run_command", "--attach", str(node.numbers[0])]
    with subprocess.Popen(argv, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        wait_until(lambda: node.begun, "the command")
        process.send_signal(signal.SIGINT)
        process.send_signal(signal.SIGTERM)
        wait_until(lambda: node.cancelled, "the cancellation")
        time.sleep(0.3)
        assert process.poll() is None, "nobody wanted it to be left alone"
        process.kill()


def test_a_goal_whose_acceptance_was_lost_is_carried_out_once(machine, monkeypatch):
    lost, execute = [], ActionClient.execute

    async def lossy(self, taken):
        if "goal" in taken and not lost:
            lost.append(taken)
            return
        await execute(self, taken)

    monkeypatch.setattr(ActionClient, "execute", lossy)
    assert machine(node := Dispatcher()).run("move").result == RESULTS
    assert (len(node.begun), len(lost)) == (1, 1)


class Anew(Dispatcher):
    """Begins anew with each goal, and goes on with the commands that it was given."""

    def _accept(self, goal):
        self.numbers.append(self.numbers[-1] + (not goal.attach))
        return super()._accept(goal)


@pytest.mark.parametrize("times", [1, 2])
def test_a_command_whose_dispatcher_does_not_know_the_goal_any_more_is_attached_to(machine, monkeypatch, times):
    forget(monkeypatch, times)
    command = machine(node := Anew()).run("move")
    assert (command.result, command.number, node.attached) == (RESULTS, 4, [4] * times)
    assert "attaching to number 4" in str(next(command.progress()))


def test_a_command_that_fails_without_a_reason_says_so(machine):
    class Mute(Dispatcher):
        async def _do(self, handle):
            handle.abort()
            return ExecuteCommand.Result()

    with pytest.raises(CommandFailedError, match="the server of /dispatcher/execute gave no reason"):
        machine(Mute()).run("move")


def test_a_machine_that_has_ended_is_not_waited_for(machine):
    """Whoever knows of the machine on this host says so."""
    ended = []
    command = machine(node := Dying(), watch=lambda silent_s: ": it has ended" if ended else "").run("move", wait=False)
    node.silent = True
    ended.append(True)
    with pytest.raises(UnreachableError, match=r"dispatcher is missing \(last heard .* s ago\): it has ended"):
        _ = command.result


def test_a_made_up_heartbeat_is_no_new_incarnation_of_a_task_that_lives(machine, wait_until):
    client = machine(node := Dispatcher())
    heartbeats, seen, deadline = client._heartbeats, set(), time.monotonic() + 3.0
    while time.monotonic() < deadline:
        node.beat(8)
        clock.sleep(0.05)
        seen.add(heartbeats.incarnation("dispatcher"))
    assert seen == {7}
    node.incarnation = 9
    wait_until(lambda: heartbeats.incarnation("dispatcher") == 9, "the new incarnation")


def test_a_time_to_wait_that_is_none_is_refused():
    with pytest.raises(MachineError, match=r"^timeout is -1 s; 0 s or more is needed$"):
        Machine.connect(timeout=-1)


def test_nothing_answers_where_no_machine_runs():
    with pytest.raises(UnreachableError, match=r"no machine runs in ROS domain \d+: none was heard within 1 s"):
        Machine.connect(timeout=1.0)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            {"width": float("nan")},
            "^move: argument width is nan; finite numbers, texts, lists and mappings can be sent$",
        ),
        ({"to": [0.0, np.inf]}, r"^move: argument to is \[0\.0, inf\]; finite"),
        ({"to": object}, "^move: argument to is <class 'object'>; finite"),
        ({"priority": 11}, "priority 11 is not from -10"),
    ],
)
def test_arguments_that_cannot_be_sent_are_refused_here(machine, arguments, sentence):
    client = machine(node := Dispatcher())
    with pytest.raises(MachineError, match=sentence):
        client.run("move", **arguments)
    assert not node.begun


@pytest.mark.parametrize("given", [500, -1, "seven", True, None])
def test_a_domain_that_there_is_not_is_refused_and_does_not_end_the_process(monkeypatch, given):
    monkeypatch.setenv("ROS_DOMAIN_ID", "500")
    with pytest.raises(MachineError, match=f"'?{given or 500}'? is no ROS domain: a number from 0 to 232"):
        Machine.connect(domain=given)


def test_a_value_of_a_wrong_type_is_named_and_nothing_is_sent(machine):
    client = machine(node := Dispatcher())
    for call, sentence in (
        (lambda: client.run(5), "symbol is of type string and cannot be 5"),
        (lambda: client.run("home\0"), r"symbol is of type string and cannot be 'home.x00'"),
        (lambda: client.run("home\ud800"), r"symbol is of type string and cannot be 'home.ud800'"),
        (lambda: client.run("home", priority=2.5), "priority is of type int8 and cannot be 2.5"),
        (lambda: client.attach("seven"), "command_id is of type uint32 and cannot be 'seven'"),
        (lambda: client.attach(2**32), "command_id is of type uint32 and cannot be 4294967296"),
        (lambda: client.control(3, None), "request is of type string and cannot be None"),
        (lambda: client.camera(5).snap(), r"cameras is of type sequence<string> and cannot be \[5\]"),
        (lambda: client.camera("wall").snap("long"), "exposure is of type double and cannot be 'long'"),
        (lambda: client.dom.get("a", wait="long"), "wait is 'long', not a finite number"),
        (lambda: client.dom.put("a", String(data=5)), "a field of std_msgs.msg.String.data=5. has a value of another"),
        (lambda: client.load_net("none.yaml"), "net file none.yaml: cannot be read: No such file or directory"),
        (lambda: client.load_net(5), "net file 5: "),
        (lambda: client.unload_net("a", wait=float("nan")), "wait is nan, not a finite number"),
        (lambda: client.calibrate_camera("wall"), r"cameras is 'wall'; a list of names is needed, such as .'wall'."),
        (lambda: client.firings().__enter__().next("soon"), "timeout is 'soon', not a finite number"),
    ):
        with pytest.raises(MachineError, match=sentence):
            call()
    assert not node.begun


@pytest.mark.parametrize("lease", [1e-9, -3, float("nan"), "long"])
def test_a_lease_that_cannot_be_renewed_in_time_is_refused_and_nothing_is_reserved(lease):
    with pytest.raises(MachineError, match="lease is"), Group(None, "left").reserved(lease):
        pytest.fail("the group was reserved")


def test_numbers_of_numpy_and_whole_numbers_fit_their_fields():
    assert message_of(Snap.Request, exposure=np.float32(0.5)).exposure == 0.5
    assert type(message_of(Snap.Request, exposure=1).exposure) is float
    assert message_of(ExecuteCommand.Goal, command_id=np.int64(7), attach=np.True_).command_id == 7


class Mortal(Dispatcher):
    """Dies of a request, and is started again without it."""

    def __init__(self) -> None:
        super().__init__()
        self.create_service(ControlCommand, "/dispatcher/control_command", self._die)

    async def _die(self, request, response):
        self.incarnation += 1
        return await Future()


def test_a_request_of_which_a_task_died_is_not_waited_for(machine):
    client = machine(Mortal())
    with pytest.raises(UnreachableError, match="dispatcher died before it answered, and was started again"):
        client.control(3, "pause")


def test_a_machine_that_was_stopped_ends_each_wait(machine, wait_until):
    client = machine(node := Dispatcher())
    node.phase = TaskStatus.STOPPING
    wait_until(lambda: client.tasks == {"dispatcher": TaskStatus.STOPPING}, "the stop")
    node.silent = True
    stopped = r"dispatcher is missing \(last heard .* s ago\): the machine was stopped"
    with client.firings() as firings, pytest.raises(UnreachableError, match=stopped):
        next(iter(firings))
    for ask in (lambda: client.run("move"), lambda: client.commands, lambda: client.control(3, "pause")):
        with pytest.raises(UnreachableError, match=stopped):
            ask()


def test_firings_of_a_net_that_there_is_not_are_not_waited_for(machine):
    client = machine(node := Dispatcher())
    told = [node.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED) for _ in range(2)]
    for net, publisher in zip(("home", "gone"), told, strict=True):
        publisher.publish(NetDescription(net=net, json="{}"))
    told[1].publish(NetDescription(net="gone"))
    with client.firings("home") as firings:
        assert firings.next(0.0) is None
    for net in ("nonsense", "gone"):
        with pytest.raises(MachineError, match=f"there is no net '{net}'; there are home"), client.firings(net):
            pytest.fail("waits for firings of no net")
