"""A request whose arguments take a while to be made leaves when they are, whatever else happens or does not."""

import pytest
from rclpy.parameter import Parameter

from im_core.ros.calls import pause
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

CALLER = """
net: caller
places: {idle: {tokens: 1, resource: true}, told: , failed: }
transitions:
  ask: {symbol: call, in: idle, out: told, request: {to: callee.work, build: think}, on_failure: failed}
  tell: {in: told, out: idle, emit: call_done}
  give_up: {in: failed, out: idle, emit: call_failed}
"""
CALLEE = """
net: callee
places: {wanted: , done: , failed: }
services: {work: {entry: wanted, done: done, failed: failed}}
transitions: {work: {in: wanted, out: done, action: work, on_failure: failed}}
"""


@pytest.mark.parametrize("journal", [False, True])
def test_a_request_that_is_built_later_leaves_at_once(tmp_path, ros, wait_until, journal):
    folder = str(tmp_path / "journal") if journal else ""

    def make(net, functions):
        file = tmp_path / f"{net.split()[1]}.yaml"
        file.write_text(net)
        given = {"standalone": True, "journal_dir": folder}
        overrides = [Parameter(name, value=value) for name, value in given.items()]
        return PntNode(file.stem, [file], functions, verifier=verify_to_load, parameter_overrides=overrides)

    async def think(ctx):
        await pause(caller, 0.5)  # longer than what repeats messages, or acknowledges them, takes
        return {}

    ended = []
    caller, callee = make(CALLER, {"think": think}), make(CALLEE, {"work": lambda ctx: None})
    ros(caller, callee)
    wait_until(lambda: caller.ready and callee.ready, "the nodes")
    wait_until(lambda: caller.heartbeats.incarnation("callee") is not None, "the other node")

    async def call():
        ended.append(await caller.commands.run("call"))

    for number in range(1, 4):
        in_loop(caller, call)
        assert len(ended) == number
    assert all(outcome.success for outcome in ended)
