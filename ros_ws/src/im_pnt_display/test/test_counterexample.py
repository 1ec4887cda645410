"""A firing sequence as the display plays it."""

import json

import pytest

from im_pnt.errors import NetError
from im_pnt.netfile import parse_net
from im_pnt_analysis.simulation.replay import FiringSequence
from im_pnt_display.page.messages import drawn_counterexample

ALONE = """
net: alone
places: {a: 1, b: , c: }
transitions:
  t: {in: a, out: b, action: f, on_failure: c}
"""
CALLER = """
net: caller
places: {idle: 1, asked: , refused: }
transitions:
  ask: {in: idle, out: asked, request: server.work, on_failure: refused}
"""
SERVER = """
net: server
places: {wanted: , done: , failed: }
services: {work: {entry: wanted, done: done, failed: failed}}
transitions:
  work: {in: wanted, out: done}
"""


def test_each_step_has_the_marking_that_it_leads_to():
    firings = FiringSequence(("t.start", "t.failed"), reason="c is a trap")
    told = json.loads(json.dumps(drawn_counterexample([parse_net(ALONE)], firings)))
    assert told["reason"] == "c is a trap"
    assert [step["fired"] for step in told["steps"]] == ["", "t.start", "t.failed"]
    assert [step["markings"] for step in told["steps"]] == [
        {"alone": {"a": 1}},
        {"alone": {"t.active": 1}},
        {"alone": {"c": 1}},
    ]
    assert {node["name"] for node in told["drawings"][0]["drawing"]["nodes"]} >= {"a", "b", "c", "t"}
    assert told["repeats"] is None


def test_a_composition_is_told_net_by_net():
    nets = [parse_net(CALLER), parse_net(SERVER)]
    told = drawn_counterexample(nets, FiringSequence(("caller.ask.start",)))
    assert [net["net"] for net in told["drawings"]] == ["caller", "server"]
    assert told["steps"][0]["markings"] == {"caller": {"idle": 1}, "server": {"SI": 1, "SO": 1}}
    after = told["steps"][1]["markings"]
    assert after["caller"]["ask.active"] == 1
    assert "idle" not in after["caller"]


def test_what_can_be_repeated_for_ever_is_marked():
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: [a, b]}}")
    told = drawn_counterexample([net], FiringSequence(("t",), repeat=("t",)))
    assert told["repeats"] == 1
    assert told["steps"][-1]["markings"] == {"n": {"a": 1, "b": 2}}


def test_a_sequence_that_does_not_fit_is_refused():
    with pytest.raises(NetError, match="not enabled"):
        drawn_counterexample([parse_net(ALONE)], FiringSequence(("t.end",)))
