"""Tokens are never lost or made: invariants of the expanded nets hold at every instant, whatever actions do."""

from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.execution.events import Answer, CommandCancelled, ObjectInvalidated, Outcome
from im_pnt.execution.firing.rule import ABANDONED_CODE
from im_pnt.execution.functions import ActionContext
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import expand
from im_pnt.netfile import parse_net
from im_pnt_analysis.structure.semiflows import p_semiflows
from support.process import Clock, Process, hold

NET = """
net: n
places:
  idle: 2
  tool: 1
  ready:
  path: {data_object: path, on_invalid: [ready]}
  done:
  bad:
  lost:
transitions:
  begin: {in: idle, out: ready, symbol: go}
  plan: {in: ready, out: path, action: plan, on_failure: bad}
  move: {in: [path, tool], out: [done, tool], action: act, on_failure: [bad, tool], on_doubt: [lost, tool], timeout: 1}
  again: {in: done, out: ready, guard: again}
  finish: {in: done, out: idle, guard: not again, emit: go_done}
  found: {in: lost, out: bad}
  give_up: {in: bad, out: idle, emit: go_failed}
"""
STEPS = ("go", "end", "fail", "cancel", "invalid", "toggle", "wait", "done", "unknown", "abandon")


@settings(max_examples=50, deadline=None)
@given(st.lists(st.sampled_from(STEPS), max_size=40), st.integers(0, 3))
def test_invariants_hold_at_every_instant(steps, seed):
    again = [False]
    flows = p_semiflows(compile_net(expand(parse_net(NET)))).flows
    assert len(flows) == 2
    process: Process | None = None

    def sums() -> list[int]:
        marking = process.marking("n")
        return [sum(weight * marking.get(place, 0) for place, weight in flow.items()) for flow in flows]

    def plan(ctx: ActionContext) -> None:
        assert sums() == wanted
        if seed == 1:
            raise ImError("no plan")

    def look() -> None:
        assert sums() == wanted

    process = Process(
        [parse_net(NET)],
        {"plan": plan, "act": hold},
        {"again": lambda ctx: again[0]},
        seed=seed,
        clock=Clock(),
        record=lambda _: look(),
    )
    executor = process.exchange.nets["n"]
    initial, wanted = process.marking("n"), sums()
    numbers = [0]
    for step in steps:
        match step:
            case "go":
                numbers.append(process.command("n", "go"))
            case "end" | "fail" if process.held:
                process.end(process.held[-1][1].transition, ImError("no") if step == "fail" else None)
            case "cancel":
                executor.post(CommandCancelled(numbers[-1], ImError("enough", code="cancelled")))
            case "abandon":
                executor.post(CommandCancelled(numbers[-1], ImError("enough", code=ABANDONED_CODE)))
                process.held = [held for held in process.held if held[1].lineage.job.command.id != numbers[-1]]
            case "invalid":
                executor.post(ObjectInvalidated(f"node/{numbers[-1]}/path"))
            case "toggle":
                again[0] = not again[0]
            case "wait":
                process.wait(0.7)
            case "done" | "unknown":
                process.answers["move"] = Answer(Outcome(step))
        process.pump()
        look()
    again[0] = False
    while process.held:
        process.end(process.held[0][1].transition)
    process.pump()
    look()
    assert len(process.results) == len(numbers) - 1
    assert process.marking("n") == initial
