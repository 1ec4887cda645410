"""A net whose guards look at data objects comes when it is known whether these are valid; no other net waits for it."""

import pytest
from rclpy.parameter import Parameter

from im_core.errors import ImError
from im_core.ros import dom, qos
from im_core.ros.node import ManagedNode
from im_msgs.srv import GetObject
from im_pnt.execution.functions import woken_by
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

ALONE = [Parameter("standalone", value=True)]

TICKING = """
net: ticking
places: {tick: {tokens: 1}, tock: }
transitions:
  tick: {in: tick, out: tock, delay: 0.05}
  tock: {in: tock, out: tick, delay: 0.05}
"""
GUARDED = """
net: guarded
places: {before: {tokens: 1}, after: }
transitions:
  go: {in: before, out: after, guard: thing_is_there}
  back: {in: after, out: before, delay: 1000.0}
"""


class SlowDom(ManagedNode):
    """Says of every object that it is valid, when it is told to answer."""

    def __init__(self):
        super().__init__("dom", parameter_overrides=ALONE)
        self.asked, self.answer = 0, self.promise()
        self.create_service(GetObject, "/dom/get", self._get, qos_profile=qos.QUEUED_SERVICE)

    async def _get(self, request, response):
        self.asked += 1
        await self.answer
        response.success, response.status.code = True, "ok"
        response.object.name, response.object.version, response.object.valid = request.name, 1, True
        return response


@pytest.fixture
def node(tmp_path, ros, wait_until):
    (tmp_path / "ticking.yaml").write_text(TICKING)
    node = PntNode("ticking", [tmp_path / "ticking.yaml"], verifier=verify_to_load, parameter_overrides=ALONE)
    node.functions.guards["thing_is_there"] = woken_by("data:thing")(lambda ctx: node.sources.valid("thing"))
    ros(node)
    wait_until(lambda: node.ready and ticks(node), "the net to begin")
    return node


def ticks(node):
    return node.exchange.nets["ticking"].sequence


def load(node):
    """Loads the net with the guard; returns where it is noted how that ended."""
    ended = []

    async def loading():
        try:
            ended.append(await node.load_net(parse_net(GUARDED)))
        except ImError as error:
            ended.append(error)

    in_loop(node, node.spawn, loading())
    return ended


def test_other_nets_go_on_while_dom_takes_its_time_and_the_net_begins_when_it_has_come(node, ros, wait_until):
    slow = ros(SlowDom())
    wait_until(lambda: slow.ready, "the node of the data objects")
    ended = load(node)
    wait_until(lambda: slow.asked, "the question")
    before = ticks(node)
    wait_until(lambda: ticks(node) > before + 4, "the other net to go on")
    assert not ended
    in_loop(slow, slow.answer.set_result, None)
    wait_until(lambda: ended, "the net")
    assert not isinstance(ended[0], ImError)
    wait_until(lambda: node.exchange.nets["guarded"].marking() == {"after": 1}, "what its guard allows")
    before = ticks(node)
    wait_until(lambda: ticks(node) > before, "the other net to go on")


def test_a_net_whose_objects_nobody_knows_is_refused_in_a_sentence(node, monkeypatch, wait_until):
    monkeypatch.setattr(dom, "PATIENCE_S", 1.0)
    ended = load(node)
    before = ticks(node)
    wait_until(lambda: ended, "the refusal")
    assert "/dom to look at 'thing'" in ended[0].message
    assert "guarded" not in node.exchange.nets
    assert not node.sources.follows("thing")
    assert ticks(node) > before + 4
