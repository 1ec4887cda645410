"""The Dispatcher takes a net into execution only if it may run with all others, and with what its commands need."""

import threading

import pytest
import rclpy

from im_core.errors import ImError
from im_core.ros.run import spin_in_thread
from im_dispatcher.ros.node import Dispatcher
from im_msgs.srv import LoadNet
from im_pnt.netfile import parse_net

GRAB = """
net: grab
commands: {grab: {needs: [NEED]}}
places: {idle: {tokens: 1, resource: true}, done: , failed: }
transitions:
  go: {symbol: grab, in: idle, out: done, request: ASKED, on_failure: failed}
  tell: {in: done, out: idle, emit: grab_done}
  give_up: {in: failed, out: idle, emit: grab_failed}
"""


@pytest.fixture
def dispatcher(tmp_path, monkeypatch, wait_until):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    rclpy.init(args=["--ros-args", "-p", "standalone:=true", "-p", "commands:=demo"])
    node = Dispatcher()
    with spin_in_thread(node):
        wait_until(lambda: node.ready or node.failed, "the dispatcher", 60.0)
        assert not node.failed
        yield node
    rclpy.try_shutdown()


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
