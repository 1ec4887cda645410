"""Data objects belong to the command that they are made for: whose object a token stands for, and who sees which."""

import pytest

from im_pnt.execution.events import GuardsChanged, ObjectInvalidated
from im_pnt.execution.functions import ActionContext
from im_pnt.netfile import parse_net
from support.process import Process, hold

PLANNING = """
net: planning
places: {idle: 2, planned: {data_object: path, on_invalid: [stale]}, stale: , moved: , shared: {SHARED}, bad: }
transitions:
  plan: {symbol: go, in: idle, out: planned, action: plan, on_failure: bad}
  move: {in: planned, out: moved, action: move, on_failure: bad, guard: free}
  done: {in: moved, out: idle, emit: go_done}
  lost: {in: stale, out: idle, emit: go_failed}
  give_up: {in: bad, out: idle, emit: go_failed}
"""


def planning(
    shared: str = "data_object: {name: map, scope: global}",
) -> tuple[Process, dict[int, list[str]], list[bool]]:
    """Two commands may be under way; what their actions call their objects, by command, and whether they may move."""
    named: dict[int, list[str]] = {}
    free = [False]

    def note(ctx: ActionContext) -> None:
        named.setdefault(ctx.command.id, []).extend(map(ctx.object, ("path", "map", "/calibration", "observation/3")))

    process = Process(
        [parse_net(PLANNING.replace("SHARED", shared))], {"plan": note, "move": note}, {"free": lambda ctx: free[0]}
    )
    return process, named, free


def test_objects_of_the_same_name_are_of_their_commands_and_those_of_the_machine_have_one_name():
    process, named, free = planning()
    process.command("planning", "go")
    process.command("planning", "go")
    free[0] = True
    process.exchange.nets["planning"].post(ObjectInvalidated("nothing"))
    process.pump()
    of_command = {
        number: [f"node/{number}/path", "map", "calibration", f"node/{number}/observation/3"] for number in (1, 2)
    }
    assert {number: names[:4] for number, names in named.items()} == of_command


def test_a_token_is_withdrawn_when_the_object_of_its_own_command_loses_its_validity():
    process, _, _ = planning()
    first, second = process.command("planning", "go"), process.command("planning", "go")
    executor = process.exchange.nets["planning"]
    for stranger in ("path", "planning/path", "node/7/path", f"node/{first}/map", f"other/{second}/path"):
        executor.post(ObjectInvalidated(stranger))
        process.pump()
        assert process.marking("planning") == {"planned": 2}
    executor.post(ObjectInvalidated(f"node/{second}/path"))
    process.pump()
    assert process.marking("planning") == {"planned": 1, "idle": 1}
    (ended,) = process.results
    assert str(ended.error) == f"data object node/{second}/path lost its validity"
    executor.post(ObjectInvalidated(f"node/{first}/path"))
    process.pump()
    assert len(process.results) == 2


def test_an_object_of_the_machine_is_everybodys():
    process, _, _ = planning()
    text = PLANNING.replace("data_object: path", "data_object: {name: path, scope: global}").replace("SHARED", "")
    process = Process([parse_net(text)], {"plan": lambda ctx: None, "move": hold}, {"free": lambda ctx: False})
    process.command("planning", "go")
    process.command("planning", "go")
    process.exchange.nets["planning"].post(ObjectInvalidated("path"))
    process.pump()
    assert [str(result.error) for result in process.results] == ["data object path lost its validity"] * 2


def test_what_must_be_valid_when_an_action_has_ended_is_its_own_commands_object():
    process, _, _ = planning()
    checked: list[tuple[str, ...]] = []
    net = parse_net(PLANNING.replace("SHARED", ""))
    process = Process([net], {"plan": hold, "move": hold}, {"free": lambda ctx: True})
    for _ in range(2):
        process.command("planning", "go")
    checked = [activity.objects for _, activity, _ in process.held]
    assert checked == [("node/1/path",), ("node/2/path",)]


@pytest.mark.parametrize("caller", ["boss", "nobody"])
def test_a_request_carries_the_scope_of_the_command_that_it_is_done_for(caller):
    """Whoever works for a command calls its objects alike; what a net does for nobody has objects of that net."""
    heard = []
    server = parse_net(
        """
net: server
places: {asked: , told: , refused: }
services: {work: {entry: asked, done: told, failed: refused}}
transitions: {work: {in: asked, out: told, action: work, on_failure: refused}}
"""
    )
    boss = parse_net(
        """
net: boss
places: {idle: 2, asked: , bad: }
transitions:
  ask: {symbol: go, in: idle, out: asked, request: server.work, on_failure: bad}
  done: {in: asked, out: idle, emit: go_done}
  failed: {in: bad, out: idle, emit: go_failed}
"""
    )
    nobody = parse_net(
        """
net: nobody
places: {idle: 1, asked: }
transitions: {ask: {in: idle, out: asked, request: server.work, on_failure: asked}}
"""
    )
    nets = [server, boss if caller == "boss" else nobody]
    process = Process(nets, {"work": lambda ctx: heard.append(ctx.object("path"))})
    process.pump()
    if caller == "boss":
        process.command("boss", "go")
        process.command("boss", "go")
        assert heard == ["node/1/path", "node/2/path"]
    else:
        assert heard == ["nobody/0/path"]


def test_a_name_says_arguments_so_that_a_place_stands_for_several_objects_of_a_command():
    net = parse_net(
        """
net: arms
places: {asked: , planned: {data_object: "path/${arguments.group}", on_invalid: [lost]}, lost: , moved: }
at_once: 2
services: {move: {entry: asked, done: moved, failed: lost, arguments: {group: {type: string}}}}
transitions:
  plan: {in: asked, out: planned, action: plan, on_failure: lost}
  move: {in: planned, out: moved, guard: free}
"""
    )
    both = parse_net(
        """
net: both
places: {idle: 1, left: , right: , left_done: , right_done: , left_lost: , right_lost: }
transitions:
  begin: {symbol: go, in: idle, out: [left, right]}
  left: {in: left, out: left_done, request: {to: arms.move, arguments: {group: left}}, on_failure: left_lost}
  right: {in: right, out: right_done, request: {to: arms.move, arguments: {group: right}}, on_failure: right_lost}
  done: {in: [left_done, right_done], out: idle, emit: go_done}
  half: {in: [left_lost, right_done], out: idle, emit: go_failed}
"""
    )
    free = [False]
    process = Process([net, both], {"plan": hold}, {"free": lambda ctx: free[0]})
    process.command("both", "go")
    assert [activity.objects for _, activity, _ in process.held] == [("node/1/path/left",), ("node/1/path/right",)]
    while process.held:
        process.end("plan")
    process.exchange.nets["arms"].post(ObjectInvalidated("node/1/path/left"))
    process.pump()
    assert process.marking("arms") == {"planned": 1, "SI": 1, "SO": 1}
    free[0] = True
    process.exchange.nets["arms"].post(GuardsChanged())
    process.pump()
    assert [str(result.error) for result in process.results] == ["data object node/1/path/left lost its validity"]
