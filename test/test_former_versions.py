"""A net is replaced while its commands run: they end in the former version, new ones begin in the new version."""

import json
import sys
from pathlib import Path

import pytest
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core.ros import qos
from im_core.ros.calls import call_blocking, pause
from im_core.ros.guard import GuardedActionClient
from im_core.ros.node import ManagedNode
from im_core.ros.run import main, spin_in_thread
from im_dispatcher.ros.node import Dispatcher
from im_msgs.action import ExecuteCommand, Move
from im_msgs.srv import ListCommands, LoadNet
from im_pnt.errors import JournalError
from im_pnt.netfile import parse_net
from im_pnt_node.rerun.difference import Difference
from im_pnt_node.rerun.rerun import NodeRerun
from im_pnt_node.rerun.stream import streams_of
from im_pnt_node.ros.reporting.mission import TOPIC
from im_pnt_node.ros.rerun import RosMessages, RosWorld
from support.loop import in_loop
from support.warm import Warm

CARRY = """
net: carry
commands:
  carry:
    needs: ["${arguments.side}_arm"]
    arguments: {side: {type: string, choices: [left, right]}}
places: {free: {tokens: 2, resource: true}, wanted: , there: , missed: }
transitions:
  begin: {symbol: carry, in: free, out: wanted}
  reach:
    in: wanted
    out: there
    goal: {name: /arm/move, type: im_msgs/action/Move, goal: {line_speed: VERSION}}
    acts_on: ["${arguments.side}_arm"]
    on_failure: missed
  end_VERSION: {in: there, out: free, emit: carry_done, result: {version: VERSION}, on_failure: missed}
  give_up: {in: missed, out: free, emit: carry_failed}
"""
OLD, NEW = (CARRY.replace("VERSION", version) for version in "12")


class Arm(ManagedNode):
    """Moves for a version until the file of that version is there; and the client of the dispatcher."""

    def __init__(self, folder: Path) -> None:
        super().__init__("arm", parameter_overrides=[Parameter("standalone", value=True)])
        self._folder, self.goals, self.ended = folder, [], []
        ActionServer(self, Move, "/arm/move", self._move, cancel_callback=lambda _: CancelResponse.ACCEPT)
        self._run = GuardedActionClient(self, ExecuteCommand, "/dispatcher/execute")
        self._load = self.create_client(LoadNet, "/dispatcher/load_net")
        self._list = self.create_client(ListCommands, "/dispatcher/list_commands")

    async def _move(self, goal):
        version = round(goal.request.line_speed)
        self.goals.append((version, bytes(goal.goal_id.uuid)))
        while not (self._folder / f"moved_{version}").exists():
            if goal.is_cancel_requested:
                goal.canceled()
                return Move.Result()
            await pause(self, 0.02)
        self.ended.append(version)
        goal.succeed()
        return Move.Result(success=True)

    def load(self, text: str) -> LoadNet.Response:
        return call_blocking(self._load, LoadNet.Request(net_yaml=text), 60.0, "load_net")

    def run(self, side: str):
        """Gives a command, and returns the promise of its goal handle."""
        assert self._run.wait_for_server(60.0)
        arguments = json.dumps({"side": side})
        return in_loop(self, self._run.send_goal_async, ExecuteCommand.Goal(symbol="carry", arguments=arguments))

    def listed(self) -> ListCommands.Response:
        return call_blocking(self._list, ListCommands.Request(), 60.0, "list_commands")

    def versions(self) -> list[int]:
        return sorted(version for version, _ in self.goals)


@pytest.fixture(scope="module")
def warm():
    with Warm(Path(__file__).stem) as warm:
        yield warm


def given(folder: Path) -> list[str]:
    """Arguments of a dispatcher with a journal."""
    words = ["standalone:=true", "dispatcher:commands:=demo", f"dispatcher:journal_dir:={folder / 'journal'}"]
    return ["--ros-args", *(word for each in words for word in ("-p", each))]


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    rclpy.init(args=given(tmp_path))
    node = Arm(tmp_path)
    with spin_in_thread(node):
        yield node
    rclpy.try_shutdown()


@pytest.fixture
def dispatcher(arm, wait_until):
    """One in this process."""
    node = Dispatcher()
    with spin_in_thread(node):
        wait_until(lambda: node.ready or node.failed, "the dispatcher", 60.0)
        assert not node.failed
        yield node


if __name__ == "__main__":
    sys.exit(main(Dispatcher, args=given(Path(sys.argv[1]))))


def formers(node):
    """The former versions in a node, by name."""
    return {name: each for name, each in node.exchange.nets.items() if each.written.former}


def free(node):
    """Tokens at rest in the present version."""
    return node.exchange.nets["carry"].marking().get("free", 0)


def result(arm, goal, wait_until):
    """What a command has ended with."""
    wait_until(goal.done, "the command to be taken", 60.0)
    promise = in_loop(arm, goal.result().get_result_async)
    wait_until(promise.done, "the end of the command", 60.0)
    outcome = promise.result().result
    assert outcome.success, outcome.status.message
    return json.loads(outcome.results)


def test_commands_end_in_the_version_in_which_they_began(arm, dispatcher, tmp_path, wait_until):
    texts: list[str] = []
    arm.create_subscription(String, TOPIC, lambda message: texts.append(message.data), qos.EVENTS)
    wait_until(lambda: any('["node"' in text for text in texts), "the recording to begin")
    assert arm.load(OLD).success
    left = arm.run("left")
    wait_until(lambda: arm.versions() == [1], "the goal of the old version")
    told = arm.load(NEW)
    assert told.success, told.message
    (former,) = formers(dispatcher)
    assert told.message.endswith(f" goes on in its former version, {former}")
    right = arm.run("right")
    wait_until(lambda: arm.versions() == [1, 2], "the goal of the new version")
    assert free(dispatcher) == 0  # of two tokens one is in each version
    again = arm.load(OLD)
    assert f"its former version {former} has not ended its commands" in again.message

    (tmp_path / "moved_1").touch()
    assert result(arm, left, wait_until) == {"version": 1}
    wait_until(lambda: not formers(dispatcher), "the former version to go")
    assert free(dispatcher) == 1
    (tmp_path / "moved_2").touch()
    assert result(arm, right, wait_until) == {"version": 2}
    wait_until(lambda: free(dispatcher) == 2, "the tokens to be back")
    assert len(set(arm.goals)) == 2

    wait_until(lambda: any('"carry_right.end"' in text for text in texts), "the last events")
    (stream,) = streams_of(texts)
    assert {"carry", former} < NodeRerun(stream, RosWorld(), RosMessages(), {}).run().nets
    with pytest.raises(Difference, match=r"net carry, transition reach, command 2 .*\n.*line_speed: 2.0\n.*1.0"):
        NodeRerun(stream, RosWorld(), RosMessages(), {"carry": parse_net(OLD)}).run()


def test_a_command_that_needs_nothing_begins_in_the_new_version_beside_one_of_the_old(arm, dispatcher, wait_until):
    free_of_needs = [text.replace('    needs: ["${arguments.side}_arm"]\n', "") for text in (OLD, NEW)]
    old, new = (text.replace('acts_on: ["${arguments.side}_arm"]', "acts_on: []") for text in free_of_needs)
    assert arm.load(old).success
    arm.run("left")
    wait_until(lambda: arm.versions() == [1], "the goal of the old version")
    assert arm.load(new).success
    arm.run("left")
    wait_until(lambda: arm.versions() == [1, 2], "the goal of the new version")
    refused = arm.run("left")
    wait_until(refused.done, "the third command to be refused")
    promise = in_loop(arm, refused.result().get_result_async)
    wait_until(promise.done, "the end of the third command")
    assert "carry is already running (begun)" in promise.result().result.status.message


def test_a_former_version_hears_of_a_cancelled_and_an_abandoned_command(arm, dispatcher, wait_until):
    assert arm.load(OLD).success
    for side in ("left", "right"):
        arm.run(side)
    wait_until(lambda: arm.versions() == [1, 1], "the goals of the old version")
    assert arm.load(NEW).success
    (former,) = formers(dispatcher).values()
    first, second = (each.job.command.id for each in dispatcher.commands.open())
    in_loop(dispatcher, dispatcher.commands.cancel, first)
    wait_until(lambda: len(former.jobs()) == 1, "the cancelled command to end")
    said = in_loop(dispatcher, dispatcher.commands.abandon, second)
    assert f"{former.net.name}.reach" in said
    wait_until(lambda: not formers(dispatcher), "the former version to go")
    assert free(dispatcher) == 2


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (
            ("free: {tokens: 2", "free: {tokens: 1"),
            "its place free begins with 2 tokens, that of the new version with 1",
        ),
        (
            ("  give_up:", "  alone: {in: missed, inhibitors: {free: 1}, out: free, emit: carry_failed}\n  give_up:"),
            "its transition alone looks for the absence of tokens in free",
        ),
    ],
)
def test_a_version_that_would_change_what_is_proved_waits_for_rest(arm, dispatcher, wait_until, change, why):
    assert arm.load(OLD).success
    arm.run("left")
    wait_until(lambda: arm.versions() == [1], "the goal of the old version")
    told = arm.load(NEW.replace(*change))
    assert why in told.message
    assert not told.success
    assert not formers(dispatcher)


def test_a_version_that_cannot_be_written_down_does_not_come(arm, dispatcher, tmp_path, wait_until, monkeypatch):
    assert arm.load(OLD).success
    left = arm.run("left")
    wait_until(lambda: arm.versions() == [1], "the goal of the old version")
    before = dict(dispatcher.exchange.nets)

    def full():
        raise JournalError("the journal cannot be written: No space left on device", file="journal")

    with monkeypatch.context() as patched:
        patched.setattr(dispatcher._loop.journal, "compact", full)
        told = arm.load(NEW)
    assert "No space left" in told.message
    assert dispatcher.exchange.nets == before
    (tmp_path / "moved_1").touch()
    assert result(arm, left, wait_until) == {"version": 1}
    wait_until(lambda: free(dispatcher) == 2, "the token to be back")


@pytest.mark.parametrize("moment", ["both run", "the old one has ended", "before the new one begins"])
def test_a_machine_that_is_killed_keeps_both_versions(arm, warm, tmp_path, wait_until, moment):
    process = warm.start(Path(__file__).stem, tmp_path)
    try:
        assert arm._load.wait_for_service(60.0)
        assert arm.load(OLD).success
        arm.run("left")
        wait_until(lambda: arm.versions() == [1], "the goal of the old version", 60.0)
        assert arm.load(NEW).success
        if moment != "before the new one begins":
            arm.run("right")
            wait_until(lambda: arm.versions() == [1, 2], "the goal of the new version", 60.0)
        if moment == "the old one has ended":
            (tmp_path / "moved_1").touch()
            wait_until(
                lambda: [each.command_id for each in arm.listed().commands] == [2], "the old command to end", 60.0
            )
    finally:
        process.kill()
        process.wait()
    node = Dispatcher()
    with spin_in_thread(node):
        wait_until(lambda: node.ready or node.failed, "the dispatcher", 60.0)
        assert not node.failed
        if moment == "before the new one begins":
            arm.run("right")
        wait_until(lambda: arm.versions() == [1, 2], "the goal of the new version", 60.0)
        for version in (1, 2):
            (tmp_path / f"moved_{version}").touch()
        wait_until(lambda: not node.commands.open() and not formers(node) and free(node) == 2, "the ends", 60.0)
        ended = [node.commands.ended[number].results["version"] for number in node.commands.ended.newest(10)]
    assert sorted(ended) == [1, 2]
    assert sorted(arm.ended) == [1, 2]


ASK = """
net: ask
places: {idle: {tokens: 2, resource: true}, asks: , told: }
transitions:
  go: {symbol: ask, in: idle, out: asks}
  hear: {symbol: {name: confirm, of: command}, in: asks, out: told, emit: confirm_done}
  too_late: {in: asks, out: told, delay: 600}
  end: {in: told, out: idle, emit: ask_done}
"""


def test_a_word_that_names_no_command_goes_to_the_former_version_first(arm, dispatcher, wait_until):
    assert arm.load(ASK).success
    given = [in_loop(dispatcher, dispatcher.commands.write, "ask", {})]
    wait_until(lambda: dispatcher.exchange.nets["ask"].marking().get("asks"), "the first question")
    assert arm.load(ASK.replace("delay: 600", "delay: 700")).success
    given.append(in_loop(dispatcher, dispatcher.commands.write, "ask", {}))
    wait_until(lambda: dispatcher.exchange.nets["ask"].marking().get("asks"), "the second question")
    for number in given:
        in_loop(dispatcher, dispatcher.commands.write, "confirm", {})
        wait_until(lambda number=number: number in dispatcher.commands.ended, "the end of the oldest")
    wait_until(lambda: not formers(dispatcher) and not dispatcher.commands.open(), "the ends of all")
