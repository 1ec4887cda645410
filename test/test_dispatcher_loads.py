"""The Dispatcher takes a net into execution only if it may run with all others, and with what its commands need."""

import contextlib
import shutil
import threading

import pytest
import rclpy

from im_core import clock
from im_core.errors import ImError
from im_core.ros.calls import pause
from im_core.ros.run import spin_in_thread
from im_dispatcher.cell.needs import Needs
from im_dispatcher.ros import node as dispatcher_node
from im_dispatcher.ros.node import Dispatcher
from im_msgs.srv import LoadNet
from im_pnt.execution.events import ObjectInvalidated, PauseSet
from im_pnt.netfile import parse_net, yaml_text
from im_pnt_node.journal.journal import fingerprint
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

SHADOW = """
net: shadow
places: {idle: {tokens: 1, resource: true}, run: }
transitions: {go: {symbol: SYMBOL, in: idle, out: run}, end: {in: run, out: idle, emit: SYMBOL_done}}
"""
GRAB = """
net: grab
commands: {grab: {needs: [NEED]}}
places: {idle: {tokens: 1, resource: true}, done: , failed: }
transitions:
  go: {symbol: grab, in: idle, out: done, request: ASKED, on_failure: failed}
  tell: {in: done, out: idle, emit: grab_done}
  give_up: {in: failed, out: idle, emit: grab_failed}
"""


@contextlib.contextmanager
def life(wait_until, *given):
    """A life of the dispatcher."""
    rclpy.init(args=["--ros-args", *(word for each in ("standalone:=true", *given) for word in ("-p", each))])
    node = Dispatcher()
    try:
        with spin_in_thread(node):
            wait_until(lambda: node.ready or node.failed, "the dispatcher", 60.0)
            assert not node.failed
            yield node
    finally:
        rclpy.try_shutdown()


@pytest.fixture
def dispatcher(tmp_path, monkeypatch, wait_until):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    with life(wait_until, "commands:=demo") as node:
        yield node


class Begun:
    """Something that the node does meanwhile."""

    def __init__(self, node, work):
        self._ended, self._said = threading.Event(), []
        node.spawn(self._do(work))

    async def _do(self, work):
        try:
            await work
        except ImError as error:
            self._said.append(error)
        self._ended.set()

    def refused(self):
        """What it is refused for, when it has ended; None if it is not."""
        assert self._ended.wait(60.0)
        return self._said[0] if self._said else None


def done(node, work):
    """Does something in the node; returns what it is refused for."""
    return Begun(node, work).refused()


def holder(name, needs="left_arm", busy="wait"):
    """A net with a command that holds something, and one that needs nothing; both wait while the net is paused."""
    return parse_net(f"""
net: {name}
commands: {{{name}: {{needs: [{needs}], busy: {busy}}}, {name}_idle: {{}}}}
places: {{idle: {{tokens: 1, resource: true}}, run: , asleep: {{tokens: 1, resource: true}}, awake: }}
transitions:
  go: {{symbol: {name}, in: idle, out: run}}
  work: {{in: run, out: idle, delay: 0.5, emit: {name}_done}}
  wake: {{symbol: {name}_idle, in: asleep, out: awake}}
  sleep: {{in: awake, out: asleep, delay: 0.5, emit: {name}_idle_done}}
""")


def states(node):
    """How far the commands are."""
    return {each.job.command.symbol: each.state for each in node.commands.open()}


@pytest.fixture
def slow(dispatcher, monkeypatch):
    """Each verification takes a while, as that of large nets does."""
    verified = dispatcher.loader.verified

    async def slowly(*arguments, **options):
        await pause(dispatcher, 0.5)
        return await verified(*arguments, **options)

    monkeypatch.setattr(dispatcher.loader, "verified", slowly)


def test_a_net_is_proved_together_with_what_its_commands_need_of_the_cell(dispatcher):
    waits_for_itself = parse_net(GRAB.replace("NEED", "left_arm").replace("ASKED", "cell.demo"))
    refused = done(dispatcher, dispatcher.load_net(waits_for_itself))
    assert "cell" in refused.message
    assert any("grab" in step for step in refused.sequence)
    assert dispatcher.exchange.nets.keys() == {"cell", "demo"}
    assert "grab" not in dispatcher.exchange.nets["cell"].written.transitions

    stuck = parse_net(GRAB.replace("NEED", "left_arm").replace("ASKED", "cell.demo").replace("  tell:", "  # tell:"))
    refused = done(dispatcher, dispatcher.load_net(stuck))
    assert list(refused.sequence) == ["go.start", "go.end"]  # what is stuck by itself is shown by itself

    does_not_hold = parse_net(GRAB.replace("NEED", "left_arm").replace("ASKED", "demo.demo"))
    refused = done(dispatcher, dispatcher.load_net(does_not_hold))
    assert "transition go of net grab acts on right_arm, which command grab does not hold" in refused.message

    good = parse_net(GRAB.replace("NEED", "zone").replace("ASKED", "cell.demo"))
    assert done(dispatcher, dispatcher.load_net(good)) is None
    assert "grab" in dispatcher.exchange.nets["cell"].written.transitions
    assert done(dispatcher, dispatcher.unload_net("grab")) is None
    assert dispatcher.exchange.nets.keys() == {"cell", "demo"}
    assert "grab" not in dispatcher.exchange.nets["cell"].written.transitions


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({}, "load_net needs either net_file or net_yaml"),
        ({"net_file": "/a.yaml", "net_yaml": "net: a"}, "load_net needs either net_file or net_yaml"),
        ({"net_file": "/nowhere/a.yaml"}, "/nowhere/a.yaml"),
        ({"net_yaml": "net: [", "wait": 0.0}, "net:1:"),
        ({"net_yaml": GRAB, "included": ["a.yaml"]}, "a text for each path: included has 1, included_yaml 0"),
        ({"net_yaml": GRAB, "wait": float("nan")}, "wait is nan s; 0 to 3600 s are allowed"),
        ({"net_yaml": GRAB, "wait": -1.0}, "wait is -1 s"),
        ({"net_yaml": GRAB, "wait": 1e9}, "wait is 1e+09 s"),
        ({"net_yaml": GRAB.replace("NEED", "left_arn").replace("ASKED", "cell.demo")}, "did you mean 'left_arm'"),
        ({"net_yaml": SHADOW.replace("SYMBOL", "demo")}, "and shadow (net) both have the command demo"),
    ],
)
def test_a_net_that_cannot_be_loaded_is_refused_in_a_sentence(dispatcher, fields, sentence):
    answer = LoadNet.Response()

    async def load():
        await dispatcher._load_net(LoadNet.Request(**fields), answer)

    assert done(dispatcher, load()) is None
    assert not answer.success
    assert sentence in answer.message
    assert "\n" not in answer.message


def with_texts(net, old, new):
    """A net with another text in its file."""
    text = yaml_text(net)
    assert old in text
    return parse_net(text.replace(old, new, 1))


def the_same(node):
    return with_texts(node.exchange.nets["demo"].written, "Moves", "Moves")


def other_arguments(node):
    return with_texts(node.exchange.nets["home"].written, "default: left", "default: right")


def another_net(_):
    asked = "{to: home.home, arguments: {group: left}}"
    return parse_net(GRAB.replace("NEED", "left_arm").replace("ASKED", asked))


@pytest.mark.parametrize("half", [False, True], ids=["whole", "half"])
@pytest.mark.parametrize("change", [the_same, other_arguments, another_net])
def test_what_was_loaded_comes_back_with_what_its_commands_need(tmp_path, monkeypatch, wait_until, change, half):
    """Also where the process has died before the net of the cell had it."""
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    run, killed = tmp_path / "run", tmp_path / "killed"
    with life(wait_until, "commands:=demo,home", f"journal_dir:={run / 'journal'}") as node:
        net = change(node)
        refused = done(node, PntNode.load_net(node, net, 30.0) if half else node.load_net(net, 30.0))
        assert refused is None, refused
        shutil.copytree(run, killed, ignore=shutil.ignore_patterns(".*"))  # as a kill leaves it; no file half written
    with life(wait_until, "commands:=demo,home", f"journal_dir:={killed / 'journal'}") as node:
        assert fingerprint(node.exchange.nets[net.name].written) == fingerprint(net)
        ((symbol, declared),) = net.commands.items()

        def known():
            told = node.exchange.nets["cell"].written.commands.get(symbol)
            return told is not None and told.arguments == declared.arguments

        wait_until(known, "the net of the cell to have its command")


def test_nets_that_are_loaded_at_once_come_one_after_the_other(dispatcher, wait_until):
    loads = [Begun(dispatcher, dispatcher.load_net(holder(name))) for name in ("first", "second")]
    assert [load.refused() for load in loads] == [None, None]
    assert {"first", "second"} <= dispatcher.exchange.nets["cell"].written.transitions.keys()
    commands = [Begun(dispatcher, dispatcher._run(name, {})) for name in ("first", "second")]
    wait_until(lambda: states(dispatcher) == {"first": "running", "second": "waiting"}, "one to wait for the other")
    assert [command.refused() for command in commands] == [None, None]


def test_a_word_goes_to_the_net_whose_command_it_names(dispatcher, wait_until):
    text = """
net: NAME
places: {idle: {tokens: 1, resource: true}, asks: , told: }
transitions:
  go: {symbol: NAME, in: idle, out: asks}
  hear: {symbol: {name: confirm, of: command}, in: asks, out: told, emit: confirm_done}
  too_late: {in: asks, out: told, delay: 600}
  end: {in: told, out: idle, emit: NAME_done}
"""
    for name in ("one", "other"):
        assert done(dispatcher, dispatcher.load_net(parse_net(text.replace("NAME", name)))) is None
    numbers = {name: [] for name in ("one", "other")}
    for name, told in numbers.items():
        dispatcher.spawn(dispatcher.commands.run(name, started=told.append))
    wait_until(lambda: all(numbers.values()), 30.0)
    dispatcher.spawn(dispatcher.commands.run("confirm", {"command": numbers["other"][0]}))
    wait_until(lambda: "other" not in states(dispatcher), 30.0)
    assert states(dispatcher).keys() == {"one"}


def test_a_command_of_a_net_that_comes_waits_for_what_it_needs(dispatcher, slow, wait_until):
    assert done(dispatcher, dispatcher.load_net(holder("present"))) is None
    dispatcher.exchange.nets["present"].post(PauseSet(True))
    held = Begun(dispatcher, dispatcher._run("present", {}))
    load = Begun(dispatcher, dispatcher.load_net(holder("coming")))
    wait_until(lambda: "coming" in dispatcher.exchange.nets, "the net")
    command = Begun(dispatcher, dispatcher._run("coming", {}))
    wait_until(lambda: states(dispatcher) == {"present": "running", "coming": "waiting"}, "its command to wait")
    assert load.refused() is None
    dispatcher.exchange.nets["present"].post(PauseSet(False))
    assert [each.refused() for each in (held, command)] == [None, None]


def test_a_command_of_a_net_that_goes_when_it_is_at_rest_waits_for_what_it_needs(dispatcher, wait_until):
    for name in ("staying", "going"):
        assert done(dispatcher, dispatcher.load_net(holder(name))) is None
    awake = Begun(dispatcher, dispatcher._run("going_idle", {}))
    wait_until(lambda: dispatcher.exchange.nets["going"].marking().get("awake"), "the command to begin")
    in_loop(dispatcher, dispatcher.commands.hold, 1, True)
    dispatcher.exchange.nets["staying"].post(PauseSet(True))
    held = Begun(dispatcher, dispatcher._run("staying", {}))
    unload = Begun(dispatcher, dispatcher.unload_net("going", 60.0))
    command = Begun(dispatcher, dispatcher._run("going", {}))
    wait_until(lambda: "going" in states(dispatcher), "the command of the net that goes")
    clock.sleep(0.5)  # it could begin now
    assert states(dispatcher) == {"going_idle": "paused", "staying": "running", "going": "waiting"}
    dispatcher.exchange.nets["staying"].post(PauseSet(False))
    assert [each.refused() for each in (held, command)] == [None, None]
    in_loop(dispatcher, dispatcher.commands.hold, 1, False)
    assert [each.refused() for each in (awake, unload)] == [None, None]
    assert "going" not in dispatcher.exchange.nets
    assert "going" not in dispatcher.exchange.nets["cell"].written.transitions


def test_what_has_come_to_a_net_and_waits_for_its_turn_does_not_keep_it_from_being_replaced(dispatcher, monkeypatch):
    """Its command has ended, and what is told of the objects of that has just come."""
    assert done(dispatcher, dispatcher.load_net(holder("changed"))) is None
    before = dispatcher.exchange.nets["changed"]
    looks, at_rest = [], before.at_rest

    def looked_at():
        if not looks:
            for number in range(6):
                before.post(ObjectInvalidated(f"object/{number}"))
        looks.append(str(at_rest()))
        return at_rest()

    monkeypatch.setattr(before, "at_rest", looked_at, raising=True)
    assert done(dispatcher, dispatcher.load_net(holder("changed"))) is None
    assert looks[0] == "6 events wait to be taken"
    assert dispatcher.exchange.nets["changed"] is not before


def test_a_net_is_refused_whose_command_has_come_meanwhile_and_would_need_something_else(dispatcher, slow, wait_until):
    for name in ("present", "changed"):
        assert done(dispatcher, dispatcher.load_net(holder(name))) is None
    before = dispatcher.exchange.nets["changed"]
    dispatcher.exchange.nets["present"].post(PauseSet(True))
    held = Begun(dispatcher, dispatcher._run("present", {}))
    load = Begun(dispatcher, dispatcher.load_net(holder("changed", "right_arm"), 60.0))
    command = Begun(dispatcher, dispatcher._run("changed", {}))
    told = "changed (number 2) has not ended: would need other resources"
    assert load.refused().message == told
    assert dispatcher.exchange.nets["changed"] is before
    assert states(dispatcher) == {"present": "running", "changed": "waiting"}
    dispatcher.exchange.nets["present"].post(PauseSet(False))
    assert [each.refused() for each in (held, command)] == [None, None]


@pytest.mark.parametrize("needs", ["left_arm", "right_arm"])
def test_a_command_that_comes_in_the_turn_of_its_net_is_done_by_that_or_keeps_it_out(
    dispatcher, monkeypatch, wait_until, needs
):
    assert done(dispatcher, dispatcher.load_net(holder("changed"))) is None
    before, prepare = dispatcher.exchange.nets["changed"], dispatcher.loader._prepare

    async def prepared(*arguments):
        found = await prepare(*arguments)
        dispatcher.commands.write("changed", {})
        return found

    monkeypatch.setattr(dispatcher.loader, "_prepare", prepared)
    refused = done(dispatcher, dispatcher.load_net(holder("changed", needs)))
    assert (dispatcher.exchange.nets["changed"] is before) == (needs == "right_arm") == (refused is not None)
    wait_until(lambda: not dispatcher.commands.open(), "the end of the command")


def test_a_command_is_refused_whose_needs_the_cell_does_not_hand_out_yet(dispatcher):
    """As after a kill between a net and what its commands need."""
    assert done(dispatcher, PntNode.load_net(dispatcher, holder("half"))) is None
    dispatcher._know(Needs(dispatcher._command_nets(), dispatcher._resources))
    refused = done(dispatcher, dispatcher._run("half", {}))
    assert refused.message == "net cell does not take what half needs yet; ask again"


@pytest.mark.parametrize(
    ("busy", "taken", "sentence"),
    [("wait", 3, "3 commands wait already"), ("refuse", 1, "single is already running (begun); ask again")],
)
def test_of_commands_that_come_together_no_more_are_taken_than_may_wait(dispatcher, monkeypatch, busy, taken, sentence):
    monkeypatch.setattr(dispatcher_node, "MOST_WAITING", 3)
    assert done(dispatcher, dispatcher.load_net(holder("single", busy=busy))) is None
    together = in_loop(dispatcher, lambda: [Begun(dispatcher, dispatcher._run("single", {})) for _ in range(5)])
    refused = [each.refused() for each in together]
    assert refused[:taken] == [None] * taken
    assert all(sentence in error.message for error in refused[taken:])
