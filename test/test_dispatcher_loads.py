"""The Dispatcher takes a net into execution only if it may run with all others, and with what its commands need."""

import contextlib
import shutil
import threading

import pytest
import rclpy

from im_core.errors import ImError
from im_core.ros.run import spin_in_thread
from im_dispatcher.ros.node import Dispatcher
from im_msgs.srv import LoadNet
from im_pnt.journal.journal import fingerprint
from im_pnt.netfile import parse_net, yaml_text
from im_pnt.ros.node import PntNode

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


def done(node, work):
    """Does something in the node; returns what it is refused for."""
    ended, said = threading.Event(), []

    async def working():
        try:
            await work
        except ImError as error:
            said.append(error)
        ended.set()

    node.executor.create_task(working())
    node.wake()
    assert ended.wait(60.0)
    return said[0] if said else None


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
    assert (
        "transition go of net grab acts on left_cart, right_arm, right_cart, which command grab does not hold"
        in refused.message
    )

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
        ({"net_yaml": GRAB, "wait": float("nan")}, "wait is nan s; a time of 0 or more is allowed"),
        ({"net_yaml": GRAB, "wait": -1.0}, "wait is -1 s"),
        ({"net_yaml": GRAB.replace("NEED", "left_arn").replace("ASKED", "cell.demo")}, "did you mean 'left_arm'"),
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
    return parse_net(GRAB.replace("NEED", "left_arm, left_cart").replace("ASKED", asked))


@pytest.mark.parametrize("half", [False, True], ids=["whole", "half"])
@pytest.mark.parametrize("change", [the_same, other_arguments, another_net])
def test_what_was_loaded_comes_back_with_what_its_commands_need(tmp_path, monkeypatch, wait_until, change, half):
    """Also where the process has died before the net of the cell had it."""
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    run, killed = tmp_path / "run", tmp_path / "killed"
    with life(wait_until, "commands:=demo,home", f"journal_dir:={run / 'journal'}") as node:
        net = change(node)
        assert done(node, PntNode.load_net(node, net) if half else node.load_net(net)) is None
        shutil.copytree(run, killed)  # as a kill leaves it
    with life(wait_until, "commands:=demo,home", f"journal_dir:={killed / 'journal'}") as node:
        assert fingerprint(node.exchange.nets[net.name].written) == fingerprint(net)
        ((symbol, declared),) = net.commands.items()

        def known():
            told = node.exchange.nets["cell"].written.commands.get(symbol)
            return told is not None and told.arguments == declared.arguments

        wait_until(known, "the net of the cell to have its command")
