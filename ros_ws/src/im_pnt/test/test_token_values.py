"""Values of a net in execution: what an operator is told of a place or a transition."""

import pytest

from im_core.errors import NotFoundError
from im_pnt.execution.token_values import LONGEST, MOST, values_of
from im_pnt.netfile import parse_net
from support.process import Process, hold

NET = """
net: n
commands:
  go:
    arguments: {group: {type: string, default: left}, poses: {type: integers, default: []}}
places:
  idle: 1
  free: 2
  chosen: {data_object: "path/${arguments.group}"}
  shown: {data_object: /map}
  end: {}
transitions:
  begin: {in: idle, out: chosen, symbol: go}
  act: {in: chosen, out: end, action: f, on_failure: end}
  back: {in: [end, free], out: [idle, free], emit: go_done}
"""


def begun(**arguments):
    made = Process([parse_net(NET)], {"f": hold})
    made.command("n", "go", **arguments)
    return made, made.exchange.nets["n"]


def test_a_token_tells_its_command_and_arguments_and_the_name_of_its_data_object():
    _, net = begun(group="left", poses=list(range(1000)))
    net.rule.ledger.jobs()[0].results["pose"] = [1.0, 2.0]
    (action,) = values_of(net, "act")["running"]
    assert (action["command"], action["symbol"], action["does"], action["state"]) == (1, "go", "function f", "active")
    assert action["arguments"]["group"] == '"left"'
    assert len(action["arguments"]["poses"]) == LONGEST
    assert action["results"] == {"pose": "[1.0, 2.0]"}
    assert values_of(net, "chosen") == {"count": 0, "tokens": [], "objects": []}
    net.rule.mark_place("chosen", 1, net.rule.activities[next(iter(net.rule.activities))].lineage)
    told = values_of(net, "chosen")
    assert (told["count"], told["objects"]) == (1, ["node/1/path/left"])


def test_tokens_of_nobody_are_counted_and_parts_that_are_none_are_named():
    _, net = begun()
    assert values_of(net, "free") == {"count": 2, "tokens": [{}, {}]}
    net.rule.enabling.add_tokens(net.rule.place["free"], 1000)
    assert len(values_of(net, "free")["tokens"]) == MOST
    with pytest.raises(NotFoundError, match="did you mean 'free'"):
        values_of(net, "fre")


def test_a_transition_tells_what_it_was_answered_last_for_each_job():
    _, net = begun()
    net.rule.ledger.jobs()[0].replies["act"] = {"path": "p"}
    (answer,) = values_of(net, "act")["answers"]
    assert (answer["command"], answer["answer"]) == (1, {"path": '"p"'})


def test_a_subnet_tells_what_runs_within():
    made = Process([parse_net(NET.replace("  act:", "  cell.act:"))], {"f": hold})
    made.command("n", "go")
    net = made.exchange.nets["n"]
    (action,) = values_of(net, "cell")["running"]
    assert action["does"] == "function f"
    assert values_of(net, "cell.act")["running"] == [
        action | {"lasts": values_of(net, "cell.act")["running"][0]["lasts"]}
    ]
