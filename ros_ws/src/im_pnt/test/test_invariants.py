"""Tokens are never lost or made: invariants of the expanded nets hold at every instant, whatever actions do."""

from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.analysis.semiflows import p_semiflows
from im_pnt.compiled import compile_net
from im_pnt.events import CommandCancelled, ObjectInvalidated
from im_pnt.expand import expand
from im_pnt.netfile import parse_net
from im_pnt.testing import Process, hold

NET = """
net: n
places:
  idle: 2
  tool: 1
  ready:
  path: {data_object: path, on_invalid: [ready]}
  done:
  bad:
transitions:
  begin: {in: idle, out: ready, symbol: go}
  plan: {in: ready, out: path, action: act, on_failure: bad}
  move: {in: [path, tool], out: [done, tool], action: act, on_failure: [bad, tool]}
  again: {in: done, out: ready, guard: again}
  finish: {in: done, out: idle, guard: not again, emit: go_done}
  give_up: {in: bad, out: idle, emit: go_failed}
"""
STEPS = ("go", "end", "fail", "cancel", "invalid", "toggle")


@settings(max_examples=60, deadline=None)
@given(st.lists(st.sampled_from(STEPS), max_size=40), st.integers(0, 3))
def test_invariants_hold_after_every_event(steps, seed):
    again = [False]
    process = Process([parse_net(NET)], {"act": hold}, {"again": lambda ctx: again[0]}, seed=seed)
    executive = process.exchange.nets["n"]
    flows = p_semiflows(compile_net(expand(parse_net(NET)))).flows
    assert len(flows) == 2
    initial = process.marking("n")
    wanted = [sum(weight * initial.get(place, 0) for place, weight in flow.items()) for flow in flows]
    numbers = [0]
    for step in steps:
        match step:
            case "go":
                numbers.append(process.command("n", "go"))
            case "end" | "fail" if process.held:
                process.end(process.held[-1][1].transition, ImError("no") if step == "fail" else None)
            case "cancel":
                executive.post(CommandCancelled(numbers[-1], ImError("enough", code="cancelled")))
            case "invalid":
                executive.post(ObjectInvalidated("path"))
            case "toggle":
                again[0] = not again[0]
        process.pump()
        marking = process.marking("n")
        found = [sum(weight * marking.get(place, 0) for place, weight in flow.items()) for flow in flows]
        assert found == wanted
    again[0] = False
    while process.held:
        process.end(process.held[0][1].transition)
    process.pump()
    assert len(process.results) == len(numbers) - 1
    assert process.marking("n") == initial
