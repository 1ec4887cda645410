"""Nodes that are killed and come back: the command survives, whichever of its nodes dies and whatever it was doing."""

import asyncio
import contextlib
import re
import shutil
import sys
from pathlib import Path

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.action import ActionServer, CancelResponse
from rclpy.parameter import Parameter
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core import clock
from im_core.errors import ImError, StateError, WaitTimeoutError
from im_core.ros import dom, qos
from im_core.ros.calls import call_blocking, pause
from im_core.ros.node import ManagedNode
from im_core.ros.run import main, spin_in_thread
from im_core.unfinished_commands import OpenCommandNote, note, noted
from im_msgs.action import Move
from im_msgs.msg import Marking
from im_msgs.srv import ControlCommand, ControlNet, ListCommands
from im_pnt.errors import JournalError
from im_pnt.execution.events import Answer, Answered, ModeSet, Outcome, PauseSet
from im_pnt.execution.functions import idempotent, woken_by
from im_pnt.execution.jobs import ActivityState
from im_pnt.execution.operator import Mode
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.cli.journal import described
from im_pnt_node.journal.folder import Folder
from im_pnt_node.journal.log import look
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop
from support.warm import Copy, Warm

NETS = {
    **{name: (Path(__file__).parent / "nets" / f"{name}.yaml").read_text() for name in ("front", "middle")},
    "back": """
net: back
places: {wanted: , thought: , moved: , planned: , impossible: }
services: {plan: {entry: wanted, done: planned, failed: impossible}}
transitions:
  think: {in: wanted, out: thought, action: think, on_failure: impossible}
  move:
    {in: thought, out: moved, on_failure: impossible,
     goal: {name: /arm/move, type: im_msgs/action/Move, build: way}}
  tell: {in: moved, out: planned, action: tell, on_failure: impossible}
""",
}


class Server(PntNode):
    """A node with nets, whose actions wait for files of the test."""

    def __init__(self, name: str, folder: Path, **settings: object) -> None:
        self.folder = folder
        settings = {"standalone": True, "journal_dir": str(folder / "journal"), **settings}
        parameters = [Parameter(parameter, value=value) for parameter, value in settings.items()]
        functions = {"think": self.think, "way": self.way, "tell": self.tell}
        asks = {"think": idempotent(self.think)}
        super().__init__(
            name,
            [folder / f"{name}.yaml"],
            functions,
            asks=asks,
            verifier=verify_to_load,
            parameter_overrides=parameters,
        )

    async def think(self, ctx):
        """Waits for the file ``thought``; notes that it was begun, and what it remembers."""
        with (self.folder / "begun").open("a") as file:
            file.write(f"{ctx.memory.get('begun', 'never')}\n")
        ctx.memory["begun"] = "before"
        while not (self.folder / "thought").exists():
            await pause(self, 0.02)
        ctx.result["answer"] = 42

    def way(self, ctx):
        """Builds the goal, and notes that."""
        ctx.memory["way"] = "here"
        return {}

    def tell(self, ctx):
        """Relies on what was noted with the goal."""
        ctx.result["way"] = ctx.memory["way"]

    def phase_start(self) -> None:
        super().phase_start()
        if self.task_name == "front":
            self.offer_commands()
            self.create_service(Trigger, "/front/serve", self._serve)
            self.create_service(Trigger, "/front/attach", self._attach)

    async def _serve(self, request, response):
        return self.answer(response, await self.commands.run("serve"))

    async def _attach(self, request, response):
        return self.answer(response, await self.commands.attach("serve"))

    def answer(self, response, outcome):
        response.success, response.message = outcome.success, outcome.status.message
        return response


class Arm(ManagedNode):
    """Moves until the file ``moved`` is there."""

    def __init__(self, folder: Path, **kwargs) -> None:
        super().__init__("arm", **kwargs)
        self.folder, self.goals = folder, []
        ActionServer(self, Move, "/arm/move", self._move, cancel_callback=lambda _: CancelResponse.ACCEPT)

    async def _move(self, goal):
        self.goals.append(bytes(goal.goal_id.uuid))
        while not (self.folder / "moved").exists():
            if goal.is_cancel_requested:
                goal.canceled()
                return Move.Result()
            await pause(self, 0.02)
        goal.succeed()
        return Move.Result(success=True)


class Machine:
    """Processes of the nets, an arm, and a client."""

    def __init__(self, folder: Path, arm: Arm, warm: Warm) -> None:
        self.folder, self.arm, self._warm = folder, arm, warm
        self.processes = {name: self.start(name) for name in NETS}

    def start(self, name: str) -> Copy:
        return self._warm.start(Path(__file__).stem, name, self.folder)

    def kill(self, name: str) -> None:
        self.processes[name].kill()
        self.processes[name].wait()

    def restart(self, name: str) -> None:
        self.kill(name)
        self.processes[name] = self.start(name)

    def attach(self) -> Trigger.Response:
        """Asks for the command; a request that meets the server of the former incarnation is made again."""
        client = self.arm.create_client(Trigger, "/front/attach")
        for _ in range(30):
            with contextlib.suppress(WaitTimeoutError):
                return call_blocking(client, Trigger.Request(), 4.0, "attach of the test")
        return pytest.fail(f"the command did not end\n{self.journals()}")

    def serve(self):
        """Gives a command; its answer may never come."""
        client = self.arm.create_client(Trigger, "/front/serve")
        assert client.wait_for_service(60.0)
        clock.sleep(1.0)  # until the server knows the client too; what is sent before may be lost
        return client.call_async(Trigger.Request())

    def begun(self) -> list[str]:
        path = self.folder / "begun"
        return path.read_text().split() if path.exists() else []

    def allow(self, name: str) -> None:
        (self.folder / name).touch()

    def until(self, condition, what: str, seconds: float = 60.0) -> None:
        deadline = clock.monotonic() + seconds
        while not condition():
            assert clock.monotonic() < deadline, f"waited {seconds} s for {what}, in vain\n{self.journals()}"
            clock.sleep(0.02)

    def journals(self) -> str:
        """What each node has on file: who waits for whom where a command does not end."""
        folders = (self.folder / "journal" / name for name in NETS)
        return "\n\n".join("\n".join(described(look(Folder(folder)), 30)) for folder in folders if folder.exists())


@pytest.fixture(scope="module")
def warm():
    with Warm(Path(__file__).stem) as warm:
        yield warm


@pytest.fixture
def machine(tmp_path, warm):
    for name, text in NETS.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    rclpy.init()
    arm = Arm(tmp_path, parameter_overrides=[Parameter("standalone", value=True)])
    with spin_in_thread(arm):
        machine = Machine(tmp_path, arm, warm)
        yield machine
        for process in machine.processes.values():
            process.kill()
            process.wait()
    rclpy.try_shutdown()


@pytest.mark.parametrize("victim", ["middle", "back"])
def test_a_command_survives_the_death_of_a_coordinator(machine, victim):
    answer = machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.restart(victim)
    machine.allow("thought")
    machine.until(lambda: machine.arm.goals, "the goal")
    machine.allow("moved")
    machine.until(answer.done, "the answer")
    assert answer.result().success, answer.result().message
    assert len(machine.arm.goals) == 1


def test_a_command_survives_the_death_of_the_node_that_was_given_it(machine):
    machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.restart("front")
    machine.allow("thought")
    machine.allow("moved")
    answer = machine.attach()
    assert answer.success, answer.message
    assert machine.begun() == ["never"]


def test_a_goal_is_asked_about_and_not_sent_again(machine):
    machine.allow("thought")
    answer = machine.serve()
    machine.until(lambda: machine.arm.goals, "the goal")
    machine.restart("back")
    clock.sleep(3.0)
    machine.allow("moved")
    machine.until(answer.done, "the answer")
    assert answer.result().success, answer.result().message
    assert len(machine.arm.goals) == 1


@pytest.mark.parametrize("upgraded", [NETS["back"].replace("thought", "considered"), None], ids=["changed", "gone"])
def test_a_command_goes_on_in_its_nets_though_an_upgrade_has_other_files(machine, upgraded):
    answer = machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.kill("back")
    file = machine.folder / "back.yaml"
    file.unlink() if upgraded is None else file.write_text(upgraded)
    machine.processes["back"] = machine.start("back")
    machine.allow("thought")
    machine.until(lambda: machine.arm.goals, "the goal")
    machine.allow("moved")
    machine.until(answer.done, "the answer")
    assert answer.result().success, answer.result().message
    assert len(machine.arm.goals) == 1


def test_everything_may_die_at_once(machine):
    machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.until(lambda: noted(machine.folder), "the note of the command")
    for name in NETS:
        machine.kill(name)
    assert noted(machine.folder) == [OpenCommandNote("front", 1, "serve")]
    for name in NETS:
        machine.processes[name] = machine.start(name)
    machine.allow("thought")
    machine.allow("moved")
    answer = machine.attach()
    assert answer.success, answer.message
    assert machine.begun() == ["never", "never"]
    machine.until(lambda: not noted(machine.folder), "the command to be noted no more")


def test_after_an_emergency_stop_a_command_that_comes_back_waits_until_it_is_resumed(machine):
    machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.until(lambda: noted(machine.folder), "the note of the command")
    (machine.folder / "estop").write_text("request on /mcs/estop")
    machine.restart("front")
    asking = machine.arm.create_client(ListCommands, "/front/list_commands")
    control = machine.arm.create_client(ControlCommand, "/front/control_command")

    def state():
        with contextlib.suppress(WaitTimeoutError):  # the answer of a node that has just begun may be lost
            told = call_blocking(asking, ListCommands.Request(), 4.0, "the list").commands
            return [(each.command_id, each.state) for each in told]

    machine.until(lambda: state() == [(1, "paused")], "the command to come back paused")
    machine.allow("thought")
    machine.allow("moved")
    clock.sleep(2.0)
    told = []
    machine.until(lambda: told.append(state()) or told[-1] is not None, "the list")
    assert told[-1] == [(1, "paused")]
    resumed = call_blocking(control, ControlCommand.Request(command_id=1, request="resume"), 20.0, "the resumption")
    assert resumed.success, resumed.message
    assert machine.attach().success


def behead(machine, name):
    """Kills a node, and cuts its journal in the header; returns the file."""
    machine.kill(name)
    journal = max((machine.folder / "journal" / name).glob("*.journal"))
    journal.write_bytes(journal.read_bytes()[:100])
    return journal


def test_after_a_damaged_journal_the_command_ends_with_it_as_reason_and_the_next_one_works(machine):
    answer = machine.serve()
    machine.until(machine.begun, "the action to begin")
    journal = behead(machine, "back")
    machine.processes["back"] = machine.start("back")
    machine.until(answer.done, "the answer")
    assert not answer.result().success
    assert "back came back without its journal" in answer.result().message
    (kept,) = journal.parent.glob("damaged-*/*.journal")
    assert len(kept.read_bytes()) == 100
    machine.allow("thought")
    machine.allow("moved")
    following = machine.serve()
    machine.until(following.done, "the answer to the next command")
    assert following.result().success, following.result().message


def test_whoever_asks_for_a_command_that_a_damaged_journal_forgot_is_told_so(machine):
    machine.serve()
    machine.until(machine.begun, "the action to begin")
    behead(machine, "front")
    machine.processes["front"] = machine.start("front")
    answer = machine.attach()
    assert not answer.success
    assert "the journal of front was damaged, and what it told is forgotten" in answer.message
    machine.allow("thought")
    machine.allow("moved")
    following = machine.serve()
    machine.until(following.done, "the answer to the next command")
    assert following.result().success, following.result().message


def test_a_command_that_only_a_note_beside_an_old_journal_knows_ends_with_that_as_reason(machine):
    machine.until(lambda: list((machine.folder / "journal" / "front").glob("*.journal")), "the journal")
    shutil.copytree(machine.folder / "journal" / "front", machine.folder / "old")
    machine.serve()
    machine.until(machine.begun, "the action to begin")
    machine.until(lambda: noted(machine.folder), "the note of the command")
    machine.kill("front")
    shutil.rmtree(machine.folder / "journal" / "front")
    shutil.move(machine.folder / "old", machine.folder / "journal" / "front")
    machine.processes["front"] = machine.start("front")
    answer = machine.attach()
    assert not answer.success
    assert "serve (number 1) was under way when front ended: the journal of front does not know it" in answer.message
    machine.allow("thought")
    machine.allow("moved")
    following = machine.serve()
    machine.until(following.done, "the answer to the next command")
    assert following.result().success, following.result().message


@pytest.mark.parametrize(("sync", "waits"), [("os", False), ("disk", True)])
def test_a_journal_waits_for_the_disk_where_it_is_told_to(tmp_path, ros, monkeypatch, sync, waits):
    (tmp_path / "front.yaml").write_text(NETS["front"])
    synced = []
    monkeypatch.setattr("os.fdatasync", synced.append)
    node = Server("front", tmp_path, journal_sync=sync)
    node.phase_configure()
    synced.clear()
    journal = node._loop.journal
    journal.recorder("front")(ModeSet(Mode.SUPERVISED))
    journal.write()
    assert bool(synced) is waits
    node.destroy_node()


def test_a_node_goes_on_saying_what_it_has_forgotten(tmp_path, ros, wait_until):
    (tmp_path / "front.yaml").write_text(NETS["front"])
    first = Server("front", tmp_path)
    first.phase_configure()
    first.destroy_node()
    (journal,) = (tmp_path / "journal" / "front").glob("*.journal")
    journal.write_bytes(journal.read_bytes() + b"000000")
    heard = []
    node = ros(Server("front", tmp_path))
    node.create_subscription(DiagnosticArray, "/diagnostics", lambda told: heard.extend(told.status), qos.STATUS)
    told = wait_until(lambda: [s for s in heard if s.name == "front: journal"], "the node to say it")[0]
    assert told.level == DiagnosticStatus.WARN
    assert f"{journal}: what was written last" in told.message
    assert "is not whole (6 bytes) and is dropped" in told.values[0].value


LONE = """
net: lone
places: {idle: 1, asked: , happy: , sad: }
transitions:
  begin: {in: idle, out: asked, symbol: serve}
  try: {in: asked, out: happy, action: try, on_failure: sad}
  finish: {in: happy, out: idle, emit: serve_done}
  give_up: {in: sad, out: idle, emit: serve_failed}
"""


EVENTS = {
    "forgot": "the journal of lone has lost its end",
    "restarted": "motion",
    "lost_object": "data object 'path' cannot be read: in the object store x its bytes are damaged",
}


@pytest.mark.parametrize("success", [True, False])
@pytest.mark.parametrize("event", EVENTS)
def test_a_command_that_fails_after_an_event_tells_the_event(ros, tmp_path, wait_until, success, event):
    """As where a node asks once more for what it does not know that it has asked for: the refusal names no journal."""
    (tmp_path / "lone.yaml").write_text(LONE)
    begun, outcomes = [], []

    async def attempt(ctx):
        begun.append(ctx)
        while not (tmp_path / "go").exists():
            await pause(node, 0.02)
        if not success:
            raise StateError("group 'left' is moving", code="moving")

    async def serve():
        outcomes.append(await node.commands.run("serve"))

    parameters = [Parameter("standalone", value=True), Parameter("journal_dir", value=str(tmp_path / "journal"))]
    files, functions = [tmp_path / "lone.yaml"], {"try": attempt}
    node = ros(PntNode("lone", files, functions, verifier=verify_to_load, parameter_overrides=parameters))
    wait_until(lambda: node.ready, "the node")
    node.spawn(serve())
    wait_until(lambda: begun, "the action to begin")
    getattr(node._observer, event)(EVENTS[event])
    (tmp_path / "go").touch()
    wait_until(lambda: outcomes, "the command to end")
    node.spawn(serve())
    wait_until(lambda: len(outcomes) == 2, "the next one to end")
    assert [outcome.success for outcome in outcomes] == [success, success]
    if not success:
        first, second = (outcome.status for outcome in outcomes)
        assert re.search(f"group 'left' is moving; before that: {EVENTS[event]}(?: was started again)?$", first.message)
        assert first.code == second.code
        assert "before that" not in second.message


def test_a_command_that_fails_after_its_node_was_started_again_says_so(ros, tmp_path, wait_until):
    (tmp_path / "lone.yaml").write_text(LONE)
    begun = []

    async def attempt(ctx):
        begun.append(ctx)
        await pause(nodes[0], 600.0)

    parameters = [Parameter("standalone", value=True), Parameter("journal_dir", value=str(tmp_path / "journal"))]
    files, functions, nodes = [tmp_path / "lone.yaml"], {"try": attempt}, []

    def lone():
        nodes[:] = [PntNode("lone", files, functions, verifier=verify_to_load, parameter_overrides=parameters)]
        return nodes[0]

    first = ros(lone())
    wait_until(lambda: first.ready, "the node")
    first.spawn(first.commands.run("serve"))
    wait_until(lambda: begun, "the action to begin")
    shutil.copytree(tmp_path / "journal", tmp_path / "kept")
    parameters[1] = Parameter("journal_dir", value=str(tmp_path / "kept"))
    second = ros(lone())
    wait_until(lambda: second.commands.ended.last("serve"), "the command to end")
    assert second.commands.ended.last("serve").message.endswith("; before that: lone was started again")


@pytest.mark.parametrize("file", ["lone.yaml", "mended.yaml"])
def test_a_net_at_rest_in_the_journal_gives_way_to_the_file_of_the_next_start(ros, tmp_path, wait_until, file):
    functions = dict.fromkeys(("try", "mend", "again"), lambda ctx: None)

    def lone(path, journal):
        folder = Parameter("journal_dir", value=str(tmp_path / journal))
        given = [Parameter("standalone", value=True), folder]
        return PntNode("lone", [path], functions, verifier=verify_to_load, parameter_overrides=given)

    (tmp_path / "lone.yaml").write_text(LONE)
    first = lone(tmp_path / "lone.yaml", "try")
    first.phase_configure()
    first.destroy_node()
    for former, function in (("try", "mend"), ("mend", "again")):
        shutil.copytree(tmp_path / former, tmp_path / function)
        (tmp_path / file).write_text(LONE.replace("action: try", f"action: {function}"))
        node = ros(lone(tmp_path / file, function))
        wait_until(lambda node=node: node.begun, "the node to begin")
        assert node.exchange.nets["lone"].written.transitions["try"].action.function == function


def test_a_journal_that_waits_for_something_else_is_refused(tmp_path, ros, wait_until):
    node = ros(Server("front", tmp_path, journal_sync="tape"))
    wait_until(lambda: node.failed, "the node to refuse")
    assert re.search(r"value of the parameter journal_sync.*tape.*disk, os", node.failed)
    with pytest.raises(StateError, match=r"front has failed: .*journal_sync"):
        asyncio.run(node.commands.run("serve"))


if __name__ == "__main__":
    name, folder = sys.argv[1:]
    sys.exit(main(lambda: Server(name, Path(folder)), args=[]))


SAY = """
net: say
places: {idle: {tokens: 1, resource: true}, said: }
commands: {say: {arguments: {text: {type: string}}}}
transitions:
  say: {symbol: say, in: idle, out: said, result: {said: "${arguments.text}"}, on_failure: said}
  tell: {in: said, out: idle, emit: say_done}
"""


def test_how_a_command_has_ended_is_known_after_the_death_of_its_node_and_in_the_mission_after_it(tmp_path, ros):
    (tmp_path / "say.yaml").write_text(SAY)
    first = Server("say", tmp_path)
    first.phase_configure()
    numbers = [first.commands.write("say", {"text": text}) for text in ("one", "two")]
    executor = first.exchange.nets["say"]
    while executor.pump():
        pass
    first._loop.journal.commit()
    killed = tmp_path / "killed"
    for part in ("journal", "ended"):
        shutil.copytree(tmp_path / part, killed / part)  # as a kill leaves it
    first.destroy_node()
    again = Server("say", tmp_path, journal_dir=str(killed / "journal"))
    again.phase_configure()
    for number, text in zip(numbers, ("one", "two"), strict=True):
        with pytest.raises(StopIteration) as ended:
            again.commands.attach("say", number=number).send(None)
        assert (ended.value.value.success, ended.value.value.results) == (True, {"said": text})
    assert again.commands.write("say", {"text": "three"}) == 3
    again.destroy_node()
    note(aside := killed / "missions" / "one", "say", [OpenCommandNote("say", 3, "say")])
    (killed / "journal").rename(aside / "journal")
    anew = Server("say", tmp_path, journal_dir=str(killed / "journal"))
    anew.phase_configure()
    with pytest.raises(StopIteration) as ended:
        anew.commands.attach("say", number=1).send(None)
    assert ended.value.value.results == {"said": "one"}
    with pytest.raises(StopIteration) as ended:
        anew.commands.attach("say", number=3).send(None)
    assert ended.value.value.status.message == (
        f"the machine was started anew before it had ended; what it has left is kept in {aside}"
    )
    assert anew.commands.write("say", {"text": "four"}) == 4
    anew.destroy_node()


CRY = """
net: cry
places: {idle: {tokens: 1, resource: true}}
transitions: {cry: {symbol: cry, in: idle, out: idle, emit: cry_done}}
"""


@pytest.mark.parametrize("known", [True, False])
def test_a_net_that_cannot_be_written_down_does_not_come(tmp_path, ros, wait_until, monkeypatch, known):
    """Its journal would be that of other nets, and nobody could come back from it."""
    (tmp_path / "say.yaml").write_text(SAY)
    node = ros(Server("say", tmp_path))
    wait_until(lambda: node.ready, "the node")
    before, refused = dict(node.exchange.nets), []

    def full():
        raise JournalError("the journal cannot be written: No space left on device", file="journal")

    async def load():
        try:
            await node.load_net(parse_net(SAY if known else CRY), 30.0)
        except JournalError as error:
            refused.append(error.message)

    monkeypatch.setattr(node._loop.journal, "compact", full)
    node.spawn(load())
    wait_until(lambda: refused, "the refusal")
    assert node.exchange.nets == before


def test_a_net_whose_going_cannot_be_written_down_stays(tmp_path, ros, wait_until, monkeypatch):
    (tmp_path / "say.yaml").write_text(SAY)
    node = ros(Server("say", tmp_path))
    wait_until(lambda: node.ready, "the node")
    before, refused = list(node.exchange.nets.items()), []

    def full():
        raise JournalError("the journal cannot be written: No space left on device", file="journal")

    async def unload():
        try:
            await node.loader.unload("say", 30.0)
        except JournalError as error:
            refused.append(error.message)

    monkeypatch.setattr(node._loop.journal, "compact", full)
    node.spawn(unload())
    wait_until(lambda: refused, "the refusal")
    assert list(node.exchange.nets.items()) == before


THINK = """
net: think
places: {idle: {tokens: 1, resource: true}, asked: , known: , tired: }
transitions:
  begin: {symbol: think, in: idle, out: asked}
  think: {in: asked, out: known, action: think, on_failure: tired}
  tell: {in: known, out: idle, emit: think_done}
  give_up: {in: tired, out: idle, emit: think_failed}
"""


def test_who_cancels_or_operates_while_the_journal_cannot_be_written_is_answered(
    tmp_path, ros, wait_until, monkeypatch
):
    """What was asked for is done; that it would not outlive the process is said."""
    monkeypatch.setattr("im_pnt_node.ros.commands.commands.ANSWER_S", 0.2)
    (tmp_path / "think.yaml").write_text(THINK)
    node = Server("think", tmp_path)
    client = ManagedNode("client", parameter_overrides=[Parameter("standalone", value=True)])
    ros(node, client)
    wait_until(lambda: node.ready, "the node")
    in_loop(node, node.offer_commands)
    cancel = client.create_client(ControlCommand, "/think/control_command")
    operate = client.create_client(ControlNet, "/think/control_net")
    node.spawn(node.commands.run("think"))
    wait_until((tmp_path / "begun").exists, "the action")

    def asked():
        return [
            call_blocking(operate, ControlNet.Request(net="think", request="pause"), 20.0, "the pause"),
            call_blocking(cancel, ControlCommand.Request(command_id=1, request="cancel"), 20.0, "the cancel"),
        ]

    def full(_):
        raise JournalError("journal cannot be written: No space left on device", file="journal")

    done = ["pause", "cancel think (number 1)"]
    not_kept = "; it is done, but not on file: journal cannot be written: No space left on device"
    with monkeypatch.context() as patch:
        patch.setattr(node._loop.journal._log, "append", full)
        answers = asked()
    assert all(answer.success for answer in answers)
    assert [answer.message for answer in answers] == [f"{each}{not_kept}" for each in done]
    assert in_loop(node, lambda: node.exchange.nets["think"].paused)
    wait_until(lambda: not node._loop.journal.unwritten, "the journal, which has room again")
    assert [answer.message for answer in asked()] == done


HANG = """
net: hang
places: {idle: 1, tool: 1, chosen: , done: }
transitions:
  begin: {symbol: go, in: [idle, tool], out: chosen}
  leave: {in: chosen, out: done, guard: may_leave}
  finish: {in: done, out: [idle, tool], emit: go_done}
"""


class Hanging(PntNode):
    """A node whose command no guard lets go on."""

    def __init__(self, folder: Path, journal: str) -> None:
        settings = {"standalone": True, "journal_dir": str(folder / journal)}
        super().__init__(
            "hang",
            [folder / "hang.yaml"],
            guards={"may_leave": lambda ctx: False},
            verifier=verify_to_load,
            parameter_overrides=[Parameter(name, value=value) for name, value in settings.items()],
        )


def test_a_command_that_nothing_ends_is_abandoned_stays_so_and_its_net_is_replaced(tmp_path, ros, wait_until):
    (tmp_path / "hang.yaml").write_text(HANG)
    node, client = (
        Hanging(tmp_path, "journal"),
        ManagedNode("client", parameter_overrides=[Parameter("standalone", value=True)]),
    )
    ros(node, client)
    wait_until(lambda: node.ready, "the node")
    in_loop(node, node.offer_commands)
    control, outcomes = client.create_client(ControlCommand, "/hang/control_command"), []

    async def run():
        outcomes.append(await node.commands.run("go"))

    node.spawn(run())
    wait_until(lambda: node.exchange.nets["hang"].marking() == {"chosen": 1}, "the command to hang")

    def ask(request: str) -> ControlCommand.Response:
        return call_blocking(control, ControlCommand.Request(command_id=1, request=request), 60.0, request)

    assert ask("cancel").success
    answer = ask("abandon")
    assert (answer.success, answer.message) == (
        True,
        "abandon go (number 1): abandoned by the operator; it held: hang.chosen; given back: hang.idle, hang.tool",
    )
    left = shutil.copytree(tmp_path / "journal" / "hang", tmp_path / "killed" / "hang")  # what kill -9 would leave
    wait_until(lambda: outcomes, "the end of the command")
    assert (outcomes[0].success, outcomes[0].status.code) == (False, "abandoned")
    assert outcomes[0].status.message.startswith("abandoned by the operator; it held: hang.chosen")
    assert "go (number 1) has ended" in ask("abandon").message
    in_loop(node, lambda: node.spawn(node.load_net(parse_net(HANG.replace("guard: may_leave", "priority: 1")))))
    wait_until(lambda: node.exchange.nets["hang"].written.guards() == frozenset(), "the net that took its place")
    node.spawn(run())
    wait_until(lambda: len(outcomes) == 2, "the next command")
    assert outcomes[1].success
    assert any("abandoned by the operator; it held: hang.chosen" in line for line in described(look(Folder(left)), 30))


ASK = """
net: ask
places: {idle: {tokens: 1, resource: true}, told: , bad: }
transitions:
  go: {symbol: ask, in: idle, out: told, request: away.work, timeout: 0.1, on_failure: bad}
  tell: {in: told, out: idle, emit: ask_done}
  give_up: {in: bad, out: idle, emit: ask_failed}
"""


def test_that_a_request_is_given_up_is_on_file_at_once(tmp_path, ros, wait_until, monkeypatch):
    """While something is not, the node neither acknowledges what it gets nor repeats what it has sent."""
    monkeypatch.setattr("im_pnt_node.ros.node.TIDY_PERIOD_S", 0.1)
    (tmp_path / "ask.yaml").write_text(ASK)
    node = ros(Server("ask", tmp_path))
    wait_until(lambda: node.ready, "the node")
    net, ended = node.exchange.nets["ask"], []

    async def ask():
        ended.append(await node.commands.run("ask"))

    def doubtful():
        return [each for each in net.activities if each.state is ActivityState.IN_DOUBT]

    node.spawn(ask())
    wait_until(lambda: in_loop(node, doubtful), "doubt about the request")
    failed = Answer(Outcome.FAILED, ImError("it has failed", code="operator"), asked="the operator")
    in_loop(node, lambda: net.post(Answered(doubtful()[0], failed)))
    wait_until(lambda: ended, "the command to end")
    wait_until(lambda: in_loop(node, lambda: not node.exchange.book.items()), "the request to be given up")
    assert not in_loop(node, lambda: node._loop.journal.unwritten)


@pytest.mark.parametrize("fault", ["journal", "topic"])
def test_a_net_that_was_refused_keeps_nobody_waiting_for_the_objects_of_its_guards(
    tmp_path, ros, wait_until, monkeypatch, fault
):
    """Nobody answers for data objects here: a node that waited to know of one would fire no more."""
    monkeypatch.setattr(dom, "PATIENCE_S", 1.0)
    (tmp_path / "say.yaml").write_text(SAY)
    node = ros(Server("say", tmp_path))
    wait_until(lambda: node.ready, "the node")
    sources = ("data:thing", "topic:/unheard") if fault == "topic" else ("data:thing",)
    node.functions.guards["there"] = woken_by(*sources)(lambda ctx: True)
    refused, ended = [], []

    def full():
        raise JournalError("the journal cannot be written: No space left on device", file="journal")

    async def load():
        try:
            await node.load_net(parse_net(CRY.replace("symbol: cry,", "symbol: cry, guard: there,")), 30.0)
        except ImError as error:
            refused.append(error.message)

    async def say():
        ended.append(await node.commands.run("say", {"text": "here"}))

    with monkeypatch.context() as patch:
        if fault == "journal":
            patch.setattr(node._loop.journal, "compact", full)
        node.spawn(load())
        wait_until(lambda: refused, "the refusal")
    node.spawn(say())
    wait_until(lambda: ended, "the command of the other net to end")
    assert ended[0].success


WATCH = """
net: watch
places: {idle: {tokens: 1, resource: true}, seen: }
transitions:
  look: {in: idle, out: seen, guard: there}
  rest: {in: seen, out: idle}
"""


class Watcher(Server):
    """A node whose guard looks at a topic, and at an object of a /dom that does not answer."""

    def __init__(self, folder: Path) -> None:
        super().__init__("watch", folder)
        self.functions.guards["there"] = woken_by("data:thing", "topic:/chat")(lambda ctx: False)
        self.sources.follow("/chat", String, qos.LATCHED)

    def hear(self, text: str) -> None:
        """Takes a message of the topic."""
        self.sources._hear("/chat", lambda _: None, String(data=text))


@pytest.mark.parametrize("recorded", [False, True])
def test_what_is_heard_does_not_pile_up_while_it_is_not_known_whether_objects_are_valid(
    tmp_path, ros, wait_until, recorded
):
    (tmp_path / "watch.yaml").write_text(WATCH)
    node = ros(Watcher(tmp_path))
    if recorded:
        listener = ros(ManagedNode("listener", parameter_overrides=[Parameter("standalone", value=True)]))
        listener.create_subscription(String, "/pnt/events", lambda _: None, qos.EVENTS)
        wait_until(lambda: node.count_subscribers("/pnt/events"), "who listens")
    wait_until(lambda: node.ready, "the node")
    for number in range(100):
        in_loop(node, node.hear, f"{number}")
    assert not node._may_turn()
    assert in_loop(node, lambda: len(node.log.items)) <= 1
    assert in_loop(node, lambda: len(node.exchange.nets["watch"]._inbox)) == 1
    assert node.sources.last("/chat").data == "99"


def test_a_net_that_goes_right_after_it_has_changed_takes_no_marking_of_another_with_it(tmp_path, ros, wait_until):
    (tmp_path / "say.yaml").write_text(SAY)
    node = ros(Server("say", tmp_path))
    wait_until(lambda: node.ready, "the node")
    markings, told = [], []
    node.create_subscription(Marking, "/pnt/markings", markings.append, qos.LATCHED_MANY)
    wait_until(lambda: markings, "the marking of the net")

    async def work():
        await node.load_net(parse_net(CRY), 30.0)
        node._loop.turn()
        node._publisher.changed("cry")
        node._publisher.publish()
        node._publisher.changed("cry")  # what changes within 20 ms of that is told when they are over
        node.exchange.nets["say"].post(PauseSet(True))
        node._loop.turn()
        await node.loader.unload("cry", 30.0)
        told.append(True)

    node.spawn(work())
    wait_until(lambda: told, "the net to go")
    wait_until(lambda: any(each.net == "say" and each.paused for each in markings), "the marking of the other")
