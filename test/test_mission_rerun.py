"""A recorded mission is run again: equal, or the first difference with both sides."""

import itertools
import json
import re
import threading
from base64 import b64decode, b64encode
from collections.abc import Callable
from pathlib import Path

import pytest
from rclpy.parameter import Parameter
from rclpy.serialization import serialize_message
from std_msgs.msg import Bool, String

import im_coordinators.ros.vision as vision
from im_bag import BagWriter, Delivery
from im_bag.definitions import Definition
from im_bag.reading import messages_of
from im_core.errors import DataError
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_dispatcher.commands.calibrate_camera import CalibrateCamera
from im_dispatcher.job import PoseLoop
from im_pnt.errors import NetError
from im_pnt.execution.events import BreakpointSet, Confirmed, ModeSet, PauseSet, TokenArrived
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import Functions
from im_pnt.execution.journal_entries import JobChange, MessageBuilt, TransitionFired
from im_pnt.execution.notification import Nowhere
from im_pnt.execution.operator import Mode
from im_pnt.execution.runner import FunctionRunner
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.journal.state import net_state
from im_pnt_node.rerun.difference import Difference, first_difference
from im_pnt_node.rerun.entries import Entries
from im_pnt_node.rerun.rerun import NodeRerun
from im_pnt_node.rerun.stream import Turn, streams_of
from im_pnt_node.ros.node import PntNode
from im_pnt_node.ros.reporting.mission import TOPIC
from im_pnt_node.ros.rerun import BAD_INPUT, DIFFERS, EQUAL, RosMessages, RosWorld, main
from support.loop import in_loop

BAGS = Path(__file__).parent / "data" / "bags"
NETS = Path(__file__).parent.parent / "ros_ws/src/im_dispatcher/im_dispatcher/nets"
SHIPPED = (NETS / "calibrate_camera.yaml").read_text(encoding="utf-8").replace("include: ", f"include: {NETS}/")


def differs(capsys, *arguments) -> str:
    """What is told of the first difference."""
    assert main([*map(str, arguments)]) == DIFFERS
    return capsys.readouterr().out


def refused(capsys, *arguments) -> str:
    assert main([*map(str, arguments)]) == BAD_INPUT
    return capsys.readouterr().err


@pytest.mark.parametrize("name", ["undisturbed", "faults", "cancelled", "killed"])
def test_the_nets_of_this_installation_do_what_they_did(capsys, name):
    assert main([str(BAGS / name)]) == EQUAL
    told = capsys.readouterr().out
    found = re.search(r"equal: (\d+) nets, (\d+) firings", told)
    assert found, told
    assert int(found[1]) == 19
    assert int(found[2]) > 100


@pytest.fixture
def changed(tmp_path) -> Callable[..., Path]:
    """``changed(old, new, ...)``: the net calibrate_camera with other text."""

    def change(*pairs: str) -> Path:
        text = SHIPPED
        for old, new in zip(pairs[::2], pairs[1::2], strict=True):
            assert old in text
            text = text.replace(old, new, 1)
        file = tmp_path / "changed.yaml"
        file.write_text(text, encoding="utf-8")
        return file

    return change


def test_a_changed_guard_is_the_first_difference(capsys, changed):
    net = changed("    guard: not stays\n", "    guard: cancelled\n")
    told = differs(capsys, BAGS / "undisturbed", "--nets", net)
    assert "net calibrate_camera, transition move_robot.start, command 1 (/dispatcher)" in told
    assert "the bag:  move_robot.start fires" in told
    assert "its guard cancelled is false" in told


def test_a_changed_net_is_the_first_difference(capsys, changed):
    net = changed("  acknowledge: ", "  hurry: {in: [reported], out: [finished], priority: 5}\n  acknowledge: ")
    told = differs(capsys, BAGS / "undisturbed", "--nets", net)
    assert "net calibrate_camera, transition cell.light_off.start, command 1" in told
    assert "now:      hurry fires" in told
    assert "hurry goes first now" in told


@pytest.mark.parametrize("delay", [0.3, 0.5, 0.9, 3.0])
def test_a_firing_that_comes_later_is_the_first_difference(capsys, changed, delay):
    net = changed("  begin_pose: {in:", f"  begin_pose: {{delay: {delay}, in:")
    told = differs(capsys, BAGS / "undisturbed", "--nets", net)
    assert "net calibrate_camera, transition begin_pose, command 1 (/dispatcher)" in told
    assert "the bag:  begin_pose fires\n" in told
    assert f"now:      fires {delay:.3f} s later\n" in told
    assert f"its delay is constant(value {delay:g}); the tolerance is 0.1 s" in told


def test_a_tolerance_allows_what_comes_later(capsys, changed):
    net = changed("  begin_pose: {in:", "  begin_pose: {delay: 0.3, in:")
    assert main([str(BAGS / "undisturbed"), "--nets", str(net), "--tolerance", "0.4"]) == EQUAL
    capsys.readouterr()
    net = changed("  begin_pose: {in:", "  begin_pose: {delay: 0.05, in:")
    assert main([str(BAGS / "undisturbed"), "--nets", str(net)]) == EQUAL
    assert "0.02 s" in differs(capsys, BAGS / "undisturbed", "--nets", net, "--tolerance", "0.02")


def test_a_changed_function_is_the_first_difference(capsys, monkeypatch):
    monkeypatch.setattr(PoseLoop, "more_poses", lambda self: self.remaining > 1)
    told = differs(capsys, BAGS / "undisturbed")
    assert "the bag:  plan_ahead.plan.start fires" in told
    assert "now:      plan_ahead.end fires" in told


def test_another_request_is_the_first_difference(capsys, monkeypatch):
    monkeypatch.setattr(
        CalibrateCamera, "watchers", lambda _, ctx: {"cameras": ["wall"], "light": ctx.memory["light"]}, raising=True
    )
    monkeypatch.setattr(CalibrateCamera.watchers, "__name__", "watchers")
    told = differs(capsys, BAGS / "undisturbed")
    assert "transition look" in told
    assert "another request" in told


def test_a_builder_that_leaves_something_else_is_the_first_difference(capsys, monkeypatch):
    monkeypatch.setattr(PoseLoop, "look", lambda self: self.present)
    told = differs(capsys, BAGS / "undisturbed")
    assert "because:  its builder leaves something else: memory" in told


def test_a_data_object_that_is_not_stored_any_more_is_a_difference(capsys, monkeypatch):
    """The nets fire as they did: what was stored is read from the recording."""

    async def store_calibration(*_: object) -> None:
        pass

    monkeypatch.setattr(vision.VisionFunctions, "store_calibration", store_calibration)
    told = differs(capsys, BAGS / "undisturbed")
    assert "the bag:  put calibration: " in told
    assert "now:      nothing of that kind" in told


def test_a_function_that_judges_otherwise_is_the_first_difference(capsys, monkeypatch):
    def refuse(*_: object) -> None:
        raise DataError("this spot will not do")

    monkeypatch.setattr(vision, "require_spot", refuse)
    told = differs(capsys, BAGS / "faults")
    assert "net vision_coordinator, transition do_find_spot" in told
    assert "this spot will not do" in told


# Bags that cannot be run again.


def events(folder: Path, *texts: str, topic: str = "/pnt/events") -> Path:
    """A bag with messages of one topic."""
    bag = BagWriter(folder)
    bag.add_topic(topic, "std_msgs/msg/String", Delivery(reliable=True, latched=False, depth=1))
    for number, text in enumerate(texts, 1):
        bag.write(topic, number, serialize_message(String(data=text)))
    bag.close()
    return folder


def told(number: int, *items: object) -> str:
    head = {"node": "/n", "life": "a", "number": number, "at": 1.0, "stamp": 1.0}
    return json.dumps({**head, "items": [list(item) for item in items]})


BEGIN = ("node", "/n", "")


@pytest.mark.parametrize(
    ("texts", "sentence"),
    [
        (["nonsense"], "a message of /pnt/events"),
        ([told(2)], "does not begin with the state of its nets"),
        ([told(1, BEGIN), told(4)], "messages 2 to 3 of /n on /pnt/events are not in the bag"),
        ([told(1, BEGIN, ("net", "front", ["fire", "go", None]))], "before its state is told"),
        ([told(1, BEGIN, ("net", "front", ["fire", 3, None]))], "['fire', 3, None] is no entry of a net: 3 is no str"),
        ([told(1, BEGIN, ("odd",))], "is nothing that a node tells"),
        ([told(1, BEGIN, ("noted", ["at"], None, []))], "[] is no error"),
        ([told(1, BEGIN, ("net", ["front"], 3))], "is nothing that a node tells"),
        ([told(1, BEGIN, ("state", "n", {}, "places: 3"))], "places"),
    ],
)
def test_a_spoilt_bag_is_a_sentence(capsys, tmp_path, texts, sentence):
    assert sentence in refused(capsys, events(tmp_path / "bag", *texts))


def test_a_bag_without_events_or_a_net_that_is_not_in_it_is_a_sentence(capsys, tmp_path):
    assert "there is nothing on /pnt/events" in refused(capsys, events(tmp_path / "bag", "x", topic="/other"))
    assert "nowhere: cannot be read: No such file or directory\n" in refused(capsys, tmp_path / "nowhere")
    net = tmp_path / "net.yaml"
    net.write_text("net: stranger\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, symbol: s}}\n", encoding="utf-8")
    assert "net stranger is not in the bag" in refused(capsys, BAGS / "undisturbed", "--nets", net)


def test_of_two_nets_of_one_name_none_is_run(capsys, changed, tmp_path):
    other = tmp_path / "other.yaml"
    other.write_text(SHIPPED, encoding="utf-8")
    told = refused(capsys, BAGS / "undisturbed", "--nets", changed("guard: not stays", "guard: cancelled"), other)
    assert f"there are two nets named calibrate_camera: {tmp_path / 'changed.yaml'} and {other}" in told


def test_where_data_differ_first():
    assert first_difference({"a": [1, 2]}, {"a": [1, 3]}) == "a[1]: 2, now 3"
    assert first_difference({"a": 1}, {}) == "a: there, now missing"
    assert first_difference([1], [1]) == ""


def test_what_makes_a_message_may_be_done_earlier_than_it_was_and_counts_once():
    entries, turn = Entries(), Turn(0.0, 0, [])
    then = [TokenArrived("a", 1), MessageBuilt(7, JobChange(None, None, 0.5)), TransitionFired("t")]
    entries.recorded = [(entry, turn) for entry in then]
    assert not entries.advance(MessageBuilt(7, JobChange(None, None, 0.6)))
    assert entries.advance(then[1])
    assert entries.next() == then[0]
    assert not entries.advance(then[2]), "nothing else may"
    assert entries.advance(then[0])
    assert entries.next() == then[2], "the message was made"
    assert entries.advance(then[2])
    assert entries.next() is None


def test_messages_of_before_a_type_changed_are_named_and_not_taken_for_other_requests(
    capsys, changed, tmp_path, monkeypatch
):
    texts = [str(each.content.data) for each in messages_of(BAGS / "undisturbed", {TOPIC: ("std_msgs/msg/String",)})]
    goal = re.compile('(im_msgs/action/Move_Goal", ?")([^"]*)')
    shorter = [goal.sub(lambda found: found[1] + b64encode(b64decode(found[2])[:-8]).decode(), text) for text in texts]
    assert shorter != texts
    told = refused(capsys, events(tmp_path / "shorter", *shorter))
    assert "im_msgs/action/Move_Goal is another message here than in" in told

    net = changed("    guard: not stays\n", "    guard: cancelled\n")
    monkeypatch.setattr("im_bag.writer.full_definition", lambda _: Definition("ros2msg", "int64 data\n"))
    as_long = BagWriter(tmp_path / "as_long")
    as_long.add_topic("/count", "std_msgs/msg/UInt64", Delivery(reliable=True, latched=False, depth=1))
    monkeypatch.undo()
    as_long.add_topic(TOPIC, "std_msgs/msg/String", Delivery(reliable=True, latched=False, depth=1))
    for number, text in enumerate(texts, 1):
        as_long.write(TOPIC, number, serialize_message(String(data=text)))
    as_long.close()
    assert "std_msgs/msg/UInt64 is another message" in refused(capsys, tmp_path / "as_long", "--nets", net)


# What a node tells is enough.

NET = """
net: walker
commands: {walk: {arguments: {steps: {type: integer}}}}
places: {ready: {tokens: 1, resource: true}, counted: , walking: , tired: }
transitions:
  begin: {symbol: walk, in: ready, out: counted, action: count_steps, on_failure: tired}
  tell: {in: counted, out: walking, topic: {name: /steps, type: std_msgs/msg/String, build: words}, on_failure: tired}
  step: {in: walking, out: walking, guard: more_steps, action: step_once, on_failure: tired}
  rest: {in: walking, out: ready, guard: not more_steps, emit: walk_done, result: {}}
  give_up: {in: tired, out: ready, emit: walk_failed}
"""


def made(host):
    """The functions of the net."""

    def count_steps(ctx):
        ctx.memory["left"] = ctx.command.arguments["steps"]
        ctx.memory["at"] = host.noted("at", lambda: [host.executor("walker").sequence, id(object())])

    def words(ctx):
        ctx.memory["told"] = f"{ctx.memory['left']} steps"
        return {"data": ctx.memory["told"]}

    async def step_once(ctx):
        ctx.memory["left"] -= 1
        await host.pause(0.01)
        if ctx.memory["left"] < 0:
            raise DataError("below the ground")

    actions = {"count_steps": count_steps, "words": words, "step_once": step_once}
    return Functions(actions, {"more_steps": lambda ctx: ctx.memory["left"] != 0})


def walker_of(folder, text, make):
    """A node that runs a net, and keeps a journal; ``make`` makes its functions."""
    from im_pnt_node.ros.node_host import NodeHost

    (folder / "walker.yaml").write_text(text, encoding="utf-8")
    host = NodeHost()
    functions = make(host)
    given = {"standalone": True, "journal_dir": str(folder / "journal")}
    node = PntNode(
        "walker",
        [folder / "walker.yaml"],
        functions.actions,
        functions.guards,
        verifier=verify_to_load,
        made_by=f"{__name__}:{make.__name__}",
        parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
    )
    host.attach(node)
    return node


def listening(texts):
    """A node that keeps what nodes tell of their nets."""
    listener = GuardedNode("listener")
    listener.create_subscription(String, "/pnt/events", lambda message: texts.append(message.data), qos.EVENTS)
    return listener


def run_again(texts, **nets):
    """Runs the nets of the only node again, some in the place of those of their names."""
    (stream,) = streams_of(texts)
    return NodeRerun(stream, RosWorld(), RosMessages(), nets).run()


def test_what_a_node_tells_is_enough_to_run_its_nets_again(ros, tmp_path, wait_until):
    texts: list[str] = []
    node = walker_of(tmp_path, NET, made)
    ros(listening(texts), node)
    outcomes = []

    async def walk() -> None:
        outcomes.extend([await node.commands.run("walk", {"steps": steps}) for steps in (3, -1)])

    wait_until(lambda: texts, "the state of the net")
    node.spawn(walk())
    wait_until(lambda: len(outcomes) == 2, "both walks")
    assert [outcome.success for outcome in outcomes] == [True, False]
    wait_until(lambda: texts and "give_up" in texts[-1], "the last events")

    (stream,) = streams_of(texts)
    compared = NodeRerun(stream, RosWorld(), RosMessages(), {}).run()
    assert compared.nets == {"walker"}
    entries = [item[2][0] for turn in stream.turns for item in turn.items if item[0] == "net"]
    firings = sum(entry in ("fire", "end") for entry in entries)
    assert compared.firings == firings > 10
    assert [run_again(texts[:count]).firings for count in range(1, len(texts) + 1)][-1] == firings, "wherever it ends"
    assert entries.count("built") == 2, "what a message is made of is on file with what that left in memory"
    at = entries.index("ended", entries.index("ended") + 1)  # the first one ends the message
    left = [item for turn in stream.turns for item in turn.items if item[0] == "net"][at][2][4]
    assert left[:2] == ["change", ["keys", {"left": ["set", 2]}, []]]
    left[1][1]["left"] = ["set", 1]
    with pytest.raises(Difference, match=r"its function leaves something else: memory.*left.*1.*now 2"):
        NodeRerun(stream, RosWorld(), RosMessages(), {}).run()
    left[1][1]["left"] = ["set", 2]

    end = next(item[2] for turn in stream.turns for item in turn.items if item[0] == "net" and item[2][0] == "end")
    rest = end[3:]
    del end[3:]
    with pytest.raises(NetError, match=r"is no entry of a net: .* is not a list of number, transition, error, data"):
        NodeRerun(stream, RosWorld(), RosMessages(), {}).run()
    end.extend(rest)

    for turn in stream.turns:
        for item in turn.items:
            if item[0] == "net" and item[2][0] == "command":
                item[2][1][2]["steps"] += 1
    with pytest.raises(Difference, match="memory"):
        NodeRerun(stream, RosWorld(), RosMessages(), {}).run()


TWO_LOOKS = """
net: walker
places: {ready: {tokens: 1, resource: true}, asked: , looked: , seen: , blind: }
transitions:
  begin: {symbol: walk, in: ready, out: asked}
  look: {in: asked, out: looked, action: look, on_failure: blind}
  look_again: {in: looked, out: seen, action: look, on_failure: blind}
  rest: {in: seen, out: ready, emit: walk_done}
  give_up: {in: blind, out: ready, emit: walk_failed}
"""


def looking(host):
    """Its function, which looks until what it looks for is there."""

    async def look(ctx):
        seen = ctx.memory.setdefault("seen", [])
        while not host.noted("there", looking.there.is_set):
            await host.pause(0.02)
        seen.append(host.noted("count", lambda: next(looking.counts)))

    return Functions({"look": look})


def keeping(host):
    """Its function, which keeps what it has seen first."""
    kept = []

    async def look(ctx):
        if not kept or host.recorded:
            kept[:] = [host.noted("kept", lambda: 7)]
        while not host.noted("there", looking.there.is_set):
            await host.pause(0.02)
        ctx.memory.setdefault("seen", []).extend(kept)

    return Functions({"look": look})


@pytest.fixture(params=[looking])
def walker(ros, tmp_path, wait_until, request):
    """A node whose walks look twice; until ``there`` is set they see nothing."""
    looking.there, looking.counts = threading.Event(), itertools.count(1)
    node = ros(walker_of(tmp_path, TWO_LOOKS, request.param))
    wait_until(lambda: node.ready, "the node")
    return node


def test_a_recording_may_begin_while_an_action_runs(walker, ros, wait_until):
    """What it leaves is taken as it was; what it has read is not given to the next one that asks for the same."""
    texts: list[str] = []
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: in_loop(walker, walker.exchange.nets["walker"].busy), "the action")
    ros(listening(texts))
    wait_until(lambda: texts, "the state of the net")
    looking.there.set()
    wait_until(lambda: any('"rest"' in text for text in texts), "the last events")
    assert "".join(texts).count('["count"]') == 2
    assert run_again(texts).firings == 4


def test_a_recording_begins_with_the_state_also_where_others_are_told_before_it_is(walker, ros, wait_until):
    first: list[str] = []
    ros(listening(first))
    wait_until(lambda: first, "the state of the net")
    second: list[str] = []
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: in_loop(walker, walker.exchange.nets["walker"].busy), "the action")
    ros(listening(second))
    wait_until(lambda: any('["node"' in text for text in second), "the state of the net")
    looking.there.set()
    wait_until(lambda: any('"rest"' in text for text in second), "the last events")
    between = next(text for text in first if '["node"' not in text)  # as where the listener was a little earlier
    assert run_again([between, *second]).firings == 4
    with pytest.raises(DataError, match="the recording of /walker does not begin with the state of its nets"):
        streams_of([between])


def test_a_recording_may_end_anywhere(walker, ros, wait_until):
    """What an action does that goes on there is compared as far as it is told."""
    texts: list[str] = []
    ros(listening(texts))
    wait_until(lambda: texts, "the state of the net")
    looking.there.set()
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: any('"rest"' in text for text in texts), "the last events")
    cuts = [run_again(texts[:count]).firings for count in range(1, len(texts) + 1)]
    assert cuts == sorted(cuts)
    assert cuts[-1] == 6


@pytest.mark.parametrize("walker", [keeping], indirect=True)
def test_what_a_function_had_read_and_kept_before_the_recording_is_in_it(walker, ros, wait_until):
    texts: list[str] = []
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: in_loop(walker, walker.exchange.nets["walker"].busy), "the action")
    ros(listening(texts))
    wait_until(lambda: texts, "the state of the net")
    looking.there.set()
    wait_until(lambda: any('"rest"' in text for text in texts), "the last events")
    assert run_again(texts).firings == 4


@pytest.mark.parametrize(
    ("stop", "go_on"),
    [(PauseSet(True), PauseSet(False)), (ModeSet(Mode.SUPERVISED), ModeSet(Mode.AUTOMATIC))],
    ids=["paused", "supervised"],
)
def test_a_net_that_had_not_fired_yet_may_be_operated_when_recording_begins(walker, ros, wait_until, stop, go_on):
    texts: list[str] = []
    net = walker.exchange.nets["walker"]
    looking.there.set()
    in_loop(walker, net.post, stop)
    wait_until(lambda: not in_loop(walker, lambda: net.due), "the net to stand")
    ros(listening(texts))
    wait_until(lambda: texts, "the state of the net")
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: "command" in texts[-1], "the command")
    in_loop(walker, net.post, go_on)
    wait_until(lambda: any('"rest"' in text for text in texts), "the last events")
    assert run_again(texts).firings == 6


def test_what_was_confirmed_at_a_breakpoint_is_fired_again(walker, ros, wait_until):
    texts: list[str] = []
    net = walker.exchange.nets["walker"]
    looking.there.set()
    begins = next(name for name, each in net.written.transitions.items() if each.symbol == "walk")
    in_loop(walker, net.post, BreakpointSet(begins, True))
    wait_until(lambda: not in_loop(walker, lambda: net.due), "the net to stand")
    ros(listening(texts))
    wait_until(lambda: texts, "the state of the net")
    walker.spawn(walker.commands.run("walk"))
    wait_until(lambda: net.proposed == (begins,), "the token before the transition")
    in_loop(walker, net.post, Confirmed(begins))
    wait_until(lambda: any('"rest"' in text for text in texts), "the last events")
    assert run_again(texts).firings == 6


JOINED = """
net: joined
places: {ready: 1, given: {remote: true}, done: }
transitions: {join: {in: [ready, given], out: done}}
"""


def test_a_net_that_had_got_a_token_before_it_is_recorded_has_it_again():
    net = parse_net(JOINED)
    functions = Functions()
    begun = Executor(net, functions, FunctionRunner(functions, None, None), Nowhere(), record=lambda _: None)
    begun.post(TokenArrived("given", 1))
    begun.take()
    texts = [
        told(1, BEGIN, ("state", "joined", net_state(begun), JOINED)),
        told(2, ("net", "joined", ["fire", "join", None])),
    ]
    assert run_again(texts).firings == 1
    with pytest.raises(Difference, match=r"begins with ready: 1\n.*now: +2\n.*another initial marking"):
        run_again(texts, joined=parse_net(JOINED.replace("ready: 1", "ready: 2")))


def test_a_net_that_is_replaced_in_a_turn_in_which_it_has_fired_fires_before():
    functions = Functions()
    net = Executor(
        parse_net(JOINED), functions, FunctionRunner(functions, None, None), Nowhere(), record=lambda _: None
    )
    net.post(TokenArrived("given", 1))
    net.take()
    begun = told(1, BEGIN, ("state", "joined", net_state(net), JOINED))
    net.pump()
    fired, then = ("net", "joined", ["fire", "join", None]), ("state", "joined", net_state(net), JOINED)
    assert run_again([begun, told(2, fired, then)]).firings == 1


INTERRUPTED = """
net: walker
places: {ready: {tokens: 1, resource: true}, wanted: , there: , tired: }
interrupts:
  halt:
    during: march
    watch: {name: /halt, type: std_msgs/msg/Bool}
    if: ${message.data}
    do: [{topic: {name: /steps, type: std_msgs/msg/String, message: {data: halted}}}]
    then: skip
transitions:
  begin: {symbol: walk, in: ready, out: wanted}
  march: {in: wanted, out: there, action: march, on_failure: tired}
  arrived: {in: there, out: ready, emit: walk_done}
  give_up: {in: tired, out: ready, emit: walk_failed}
"""


def marching(host):
    """A march that only an interrupt ends."""

    async def march(ctx):
        while not ctx.cancelled:
            await host.pause(0.02)
        raise DataError("the march was cancelled", code="cancelled")

    return Functions({"march": march})


def test_an_interrupted_action_is_interrupted_again_where_it_was(ros, tmp_path, wait_until):
    texts: list[str] = []
    node = walker_of(tmp_path, INTERRUPTED, marching)
    listener = listening(texts)
    halts = listener.create_publisher(Bool, "/halt", qos.EVENTS)
    ros(listener, node)
    outcomes = []

    async def walk() -> None:
        outcomes.append(await node.commands.run("walk", {}))

    wait_until(lambda: texts, "the state of the net")
    node.spawn(walk())

    def ended():
        halts.publish(Bool(data=False))
        halts.publish(Bool(data=True))
        return outcomes

    assert wait_until(ended, "the end of the march")[0].success
    wait_until(lambda: "arrived" in texts[-1], "the last events")
    (stream,) = streams_of(texts)
    entries = [item[2][:2] for turn in stream.turns for item in turn.items if item[0] == "net"]
    assert ["fire", "march.halt.stop"] in entries
    assert NodeRerun(stream, RosWorld(), RosMessages(), {}).run().firings > 10
