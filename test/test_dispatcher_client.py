"""Clients of a dispatcher that dies and comes back: what was lost meanwhile is asked for again."""

import io
import json
import signal
import subprocess
import sys
import threading
from types import SimpleNamespace

import pytest
from action_msgs.msg import GoalStatus
from rclpy.action.server import CancelResponse, GoalResponse
from rclpy.task import Future
from std_srvs.srv import Trigger

from im_bringup.ros import dispatcher
from im_bringup.ros.interruptible import InterruptibleNode, spun
from im_bringup.ros.run_command import CommandClient
from im_core import clock
from im_core.errors import LinkError, StateError, WaitTimeoutError
from im_core.ros import qos
from im_core.ros.guard import GuardedActionClient, GuardedActionServer, GuardedNode
from im_core.startup import STATUS_TOPIC
from im_msgs.action import ExecuteCommand
from im_msgs.msg import CommandState, Status, TaskStatus
from im_msgs.srv import ListCommands
from support.forgetful import forget

RESULTS = {"message": "", "directory": "/results/1", "report": {"message": "fits"}}


class Stopped(GuardedNode):
    """A dispatcher as others see it, which a test lets forget what it was asked."""

    def __init__(self) -> None:
        super().__init__("dispatcher")
        self.begun, self.attached, self.numbers = [], [], [3]  # of which the first was an older command
        self.incarnation, self.cancelled, self.open = 7, [], []
        self._status = self.create_publisher(TaskStatus, STATUS_TOPIC, qos.STATUS)
        self.create_timer(0.1, self._beat)
        self.create_service(ListCommands, "/dispatcher/list_commands", self._list)
        GuardedActionServer(
            self, ExecuteCommand, "/dispatcher/execute", self._do,
            goal_callback=self._accept, cancel_callback=self._may_cancel,
        )  # fmt: skip

    def _beat(self):
        self._status.publish(TaskStatus(name="dispatcher", incarnation=self.incarnation, phase=TaskStatus.READY))

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


@pytest.fixture
def stopped(ros):
    return ros(Stopped())


def ended(work):
    """What a function returns, which is called in a thread."""
    done = []
    thread = threading.Thread(target=lambda: done.append(work()), daemon=True)
    thread.start()
    return done


@pytest.mark.parametrize(
    ("opened", "why"),
    [
        ([], "the dispatcher stopped before it recorded command calibrate_camera; run the command again"),
        ([(7, "home")], "the dispatcher stopped before it recorded command calibrate_camera; run the command again"),
        ([(7, "calibrate_camera"), (9, "calibrate_camera")], "this calibrate_camera is one of the commands 7, 9"),
    ],
)
def test_what_another_command_has_found_is_not_the_answer_to_this_one(ros, wait_until, opened, why):
    """The last calibration that has ended may be of another day."""

    class Dying(Stopped):
        async def _do(self, handle):
            return await Future()

    node, client = ros(Dying()), ros(CommandClient())

    def calibrate():
        with pytest.raises(StateError) as refused:
            client.run(ExecuteCommand.Goal(symbol="calibrate_camera"), io.StringIO())
        return refused.value.message

    done = ended(calibrate)
    wait_until(lambda: node.begun, "the command")
    clock.sleep(1.0)  # until it is known to be accepted
    node.numbers, node.open, node.incarnation = [3, *(number for number, _ in opened)], opened, 8
    (message,) = wait_until(lambda: done, "the refusal")
    assert why in message
    assert not node.attached


def test_who_was_interrupted_while_the_dispatcher_was_away_cancels_when_it_is_back(ros, wait_until):
    """The first life died with the cancellation."""

    class Dying(Stopped):
        async def _do(self, handle):
            self.numbers.append(self.numbers[-1] + (not handle.request.attach))
            return await Future()

    node, client = ros(Dying()), ros(CommandClient())

    def run():
        with pytest.raises(KeyboardInterrupt):
            client.run(ExecuteCommand.Goal(symbol="move"), io.StringIO())
        return "left alone"

    done = ended(run)
    wait_until(lambda: node.begun, "the command")
    clock.sleep(1.0)  # until it is known to be accepted
    client.interrupt()
    wait_until(lambda: node.cancelled == [False], "the cancellation")
    node.incarnation = 8
    wait_until(lambda: node.cancelled == [False, True], "the cancellation of what the second life goes on with")
    client.interrupt()
    wait_until(lambda: done, "the end of who was interrupted twice")


def test_a_goal_whose_acceptance_was_lost_is_carried_out_once(ros, stopped, wait_until, monkeypatch):
    lost, execute = [], GuardedActionClient.execute

    async def lossy(self, taken):
        if "goal" in taken and not lost:
            lost.append(taken)
            return
        await execute(self, taken)

    monkeypatch.setattr(GuardedActionClient, "execute", lossy)
    client = ros(CommandClient())
    done = ended(lambda: client.run(ExecuteCommand.Goal(symbol="move"), io.StringIO()))
    (result,) = wait_until(lambda: done, "the result")
    assert (result.success, len(stopped.begun), len(lost)) == (True, 1, 1)


class Anew(Stopped):
    """Begins anew with each goal, and goes on with the commands that it was given."""

    def _accept(self, goal):
        self.numbers.append(self.numbers[-1] + (not goal.attach))
        return super()._accept(goal)


@pytest.mark.parametrize("times", [1, 2])
def test_a_command_whose_dispatcher_does_not_know_the_goal_any_more_is_attached_to(ros, wait_until, monkeypatch, times):
    node, client = ros(Anew()), ros(CommandClient())
    forget(monkeypatch, times)
    done = ended(lambda: client.run(ExecuteCommand.Goal(symbol="move"), io.StringIO()))
    (result,) = wait_until(lambda: done, "the result")
    assert (result.success, node.attached) == (True, [4] * times)


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
interruptible.machine.read_running = lambda: None
def use(node):
    print("one", flush=True)
    print("two")
    print("waited to the end", file=sys.stderr)
    return interruptible.DONE
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


def test_a_machine_that_has_ended_is_not_waited_for(ros, monkeypatch):
    """Who had not found the dispatcher yet when the power went waited for a minute, and named nobody."""
    monkeypatch.setattr(dispatcher, "ALONE_S", 0.3)
    client, began = ros(CommandClient()), clock.monotonic()
    with pytest.raises(LinkError, match="list_commands is missing: the machine has ended, its bootstrap is gone"):
        client.run(ExecuteCommand.Goal(symbol="calibrate_camera"), io.StringIO())
    assert clock.monotonic() - began < 0.5 * dispatcher.DISCOVERY_S
    monkeypatch.setattr(dispatcher.machine, "read", lambda: SimpleNamespace(alive=True, state="ready"))
    with pytest.raises(WaitTimeoutError, match="for what does not come"):
        client._until(lambda: False, "what does not come", 1.0)


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


def test_a_made_up_heartbeat_is_no_new_life_of_the_dispatcher(ros, monkeypatch):
    record = SimpleNamespace(incarnations={"dispatcher": 7})
    monkeypatch.setattr(dispatcher.machine, "read", lambda: record)
    client = ros(CommandClient())
    lives = []
    for incarnation in (8, 7, 8, 0):
        client._hear(TaskStatus(name="dispatcher", incarnation=incarnation))
        lives.append(client._incarnation)
    record.incarnations["dispatcher"] = 8
    client._hear(TaskStatus(name="dispatcher", incarnation=8))
    assert [*lives, client._incarnation] == [0, 7, 7, 7, 8]


def test_a_command_that_fails_without_a_reason_says_so(ros):
    client = ros(CommandClient())
    for result, words in (
        (ExecuteCommand.Result(), "the server of /dispatcher/execute gave no reason"),
        (ExecuteCommand.Result(status=Status(message="no gas")), "no gas"),
    ):
        ended = client._result(SimpleNamespace(status=GoalStatus.STATUS_ABORTED, result=result))
        assert ended.status.message == words
