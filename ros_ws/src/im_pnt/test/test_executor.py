import gc
import sys

import pytest

from im_core.errors import DataError, ImError
from im_pnt.errors import NetError, NetFileError
from im_pnt.execution.events import CommandCancelled, GuardsChanged, ObjectInvalidated, RequestArrived
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, woken_by
from im_pnt.execution.jobs import Command, Job, Request
from im_pnt.netfile import load_net, parse_net
from support.process import Process, hold


def test_tokens_are_hidden_in_active_while_an_action_runs_and_appear_when_it_confirms():
    net = parse_net("net: n\nplaces: {a: 1, b: , bad: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: bad}}")
    process = Process([net], {"f": hold})
    process.pump()
    assert process.marking("n") == {"t.active": 1}
    process.end("t")
    assert process.marking("n") == {"b": 1}
    assert process.recorder.names("n") == ["t+", "t"]


def test_failure_is_a_third_outcome_with_its_own_arcs_and_its_facts_reach_the_next_action():
    seen: list[ImError | None] = []
    net = parse_net(
        """
net: n
places: {a: 1, b: , bad: , c: }
transitions:
  t: {in: a, out: b, action: fails, on_failure: bad}
  u: {in: bad, out: c, action: looks, on_failure: bad}
"""
    )

    def fails(ctx: ActionContext) -> None:
        raise DataError("no spot", camera="wall")

    process = Process([net], {"fails": fails, "looks": lambda ctx: seen.append(ctx.failure)})
    process.pump()
    assert process.marking("n") == {"c": 1}
    assert process.recorder.names("n") == ["t+", "t!", "u+", "u"]
    assert seen[0] is not None
    assert seen[0].facts == {"camera": "wall"}


def test_an_exception_that_is_not_ours_is_a_failure_that_names_the_transition():
    net = parse_net("net: n\nplaces: {a: 1, b: , bad: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: bad}}")
    process = Process([net], {"f": lambda ctx: 1 // 0})
    process.pump()
    assert process.marking("n") == {"bad": 1}
    assert "transition t broke: ZeroDivisionError" in process.recorder.firings[-1].message


def test_a_guard_and_its_negation_are_evaluated_once_a_decision():
    calls: list[str] = []
    net = parse_net(
        """
net: n
places: {a: 1, yes: , no: }
transitions:
  t: {in: a, out: yes, guard: g}
  u: {in: a, out: no, guard: not g}
"""
    )

    def flips(ctx: ActionContext) -> bool:
        calls.append(ctx.transition)
        return len(calls) % 2 == 0

    process = Process([net], guards={"g": flips})
    process.pump()
    assert process.marking("n") == {"no": 1}
    assert len(calls) == 1


def test_a_guard_that_is_false_is_asked_again_when_something_happens():
    allowed = [False]
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, guard: g}}")
    process = Process([net], guards={"g": lambda ctx: allowed[0]})
    process.pump()
    assert process.marking("n") == {"a": 1}
    allowed[0] = True
    process.exchange.nets["n"].post(GuardsChanged())
    process.pump()
    assert process.marking("n") == {"b": 1}


def test_a_guard_that_breaks_counts_as_false_and_is_reported():
    net = parse_net(
        "net: n\nplaces: {a: 1, b: , c: }\n"
        "transitions: {t: {in: a, out: b, guard: g}, u: {in: a, out: c, guard: not g}}"
    )
    process = Process([net], guards={"g": lambda ctx: 1 / 0 > 0})
    process.pump()
    assert process.marking("n") == {"c": 1}
    assert "guard g counts as false" in process.recorder.troubles[0]


def test_functions_that_would_end_the_process_end_what_they_are_called_for():
    net = parse_net(
        "net: n\nplaces: {a: 1, b: , c: }\n"
        "transitions: {t: {in: a, out: b, guard: g}, u: {in: a, out: c, guard: not g, action: f, on_failure: b}}"
    )
    process = Process([net], {"f": lambda ctx: sys.exit("enough")}, guards={"g": lambda ctx: sys.exit(1)})
    process.pump()
    assert process.marking("n") == {"b": 1}
    assert "guard g counts as false" in process.recorder.troubles[0]
    assert "broke: SystemExit: enough" in process.recorder.firings[-1].message


def test_the_tape_symbol_resolves_contending_transitions_and_is_consumed():
    net = parse_net(
        """
net: n
places: {idle: 1, a: , b: }
transitions:
  go_left: {in: idle, out: a, symbol: left}
  go_right: {in: idle, out: b, symbol: right}
  left_over: {in: a, out: idle, emit: left_done}
  right_over: {in: b, out: idle, emit: right_done}
"""
    )
    process = Process([net])
    process.pump()
    assert process.marking("n") == {"idle": 1}
    process.command("n", "right")
    process.command("n", "left")
    assert process.recorder.names("n") == ["go_right", "right_over", "go_left", "left_over"]
    assert [result.success for result in process.results] == [True, True]


def test_an_unknown_symbol_is_refused_with_the_nearest():
    net = parse_net("net: n\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a, symbol: calibrate}}")
    with pytest.raises(NetError, match=r"does not know the command 'calibrat' \(did you mean 'calibrate'"):
        Process([net]).command("n", "calibrat")


def test_priority_then_seed_resolve_conflicts():
    text = """
net: n
places: {a: 1, b: , c: , d: }
transitions:
  low: {in: a, out: b}
  high: {in: a, out: c, priority: 1}
  high_too: {in: a, out: d, priority: 1}
"""
    chosen = set()
    for seed in range(20):
        process = Process([parse_net(text)], seed=seed)
        process.pump()
        again = Process([parse_net(text)], seed=seed)
        again.pump()
        assert process.recorder.names("n") == again.recorder.names("n")
        chosen.update(process.marking("n"))
    assert chosen == {"c", "d"}


def test_inhibitor_and_weights():
    net = parse_net(
        """
net: n
places: {a: 4, b: , full: }
transitions:
  t: {in: {a: 2}, out: b, inhibitors: {b: 2}}
  u: {in: {b: 2}, out: full, action: f, on_failure: full}
"""
    )
    process = Process([net], {"f": hold})
    process.pump()
    assert process.marking("n") == {"u.active": 1}


def test_weights_say_how_often_a_transition_is_taken():
    text = (
        "net: n\nplaces: {a: 1000, b: , c: }\ntransitions: {often: {in: a, out: b, weight: 9}, seldom: {in: a, out: c}}"
    )
    process = Process([parse_net(text)], seed=5)
    process.pump()
    assert 850 < process.marking("n")["b"] < 950


def test_the_winner_gives_way_to_its_own_rival_of_higher_priority():
    text = """
net: n
places: {a: 1, b: 1, c: , d: , e: }
transitions:
  first: {in: a, out: c}
  second: {in: [a, b], out: d}
  third: {in: b, out: e, priority: 1}
"""
    for seed in range(20):
        process = Process([parse_net(text)], seed=seed)
        process.pump()
        assert process.marking("n") == {"c": 1, "e": 1}


def test_guards_that_are_to_be_asked_again_are_asked_once_however_often_that_is_said():
    asked: list[str] = []
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, guard: g}}")
    process = Process([net], guards={"g": woken_by("topic:/seen")(lambda ctx: asked.append(ctx.transition))})
    process.pump()
    for source in ("topic:/seen", "topic:/other") * 3:
        process.exchange.nets["n"].guards_changed(source)
    process.pump()
    assert asked == ["t", "t"]


def test_what_guards_have_said_of_commands_is_forgotten_with_them():
    net = parse_net(
        """
net: n
places: {idle: {tokens: 1, resource: true}, a: , b: }
transitions:
  go: {symbol: go, in: idle, out: a}
  yes: {in: a, out: b, guard: g}
  no: {in: a, out: b, guard: not g}
  tell: {in: b, out: idle, emit: go_done}
"""
    )
    process = Process([net], guards={"g": woken_by()(lambda ctx: True)})

    def remembered() -> int:
        gc.collect()
        return sum(isinstance(each, Job) for each in gc.get_objects())

    before = remembered()
    for _ in range(100):
        process.command("n", "go")
    assert [result.success for result in process.results] == [True] * 100
    assert remembered() <= before + 1


def test_one_symbol_resolves_several_contending_transitions():
    text = """
net: n
places: {left: 1, right: , here: 1, a: , b: }
transitions:
  go_left: {in: [left, here], out: [a, right], symbol: go}
  go_right: {in: [right, here], out: [b, left], symbol: go}
  back: {in: a, out: here, emit: go_done}
  back_too: {in: b, out: here, emit: go_done}
"""
    process = Process([parse_net(text)])
    process.command("n", "go")
    process.command("n", "go")
    assert process.recorder.names("n") == ["go_left", "back", "go_right", "back_too"]


def test_a_request_that_names_a_symbol_is_a_command_of_the_tape_of_another_net():
    net = parse_net(
        "net: n\nplaces: {idle: 1, a: }\n"
        "transitions:\n  t: {in: idle, out: a, symbol: s}\n"
        "  u: {in: a, out: idle, action: f, on_failure: idle, emit: s_done}"
    )
    replies = []

    class Outlet:
        def send_reply(self, request, error, results):
            replies.append((request.id, error, results))

    def f(ctx: ActionContext) -> None:
        assert ctx.request_arguments == {"x": 1}
        ctx.result["y"] = 2

    process = Process([], {"f": f})
    executor = Executor(net, process.functions, process, Outlet(), process.recorder)
    executor.post(RequestArrived(Request("r", "n", "s", "", "m", "ask", Command(), {"x": 1})))
    executor.post(RequestArrived(Request("q", "n", "nothing", "", "m", "ask", Command(), {})))
    executor.pump()
    assert replies[0][0] == "q"
    assert "reads no symbol nothing" in str(replies[0][1])
    assert replies[1] == ("r", None, {"y": 2})
    assert executor.at_rest()


def test_any_number_of_actions_in_flight_end_in_any_order():
    net = parse_net("net: n\nplaces: {a: 3, b: , bad: }\ntransitions: {t: {in: a, out: b, action: f, on_failure: bad}}")
    process = Process([net], {"f": hold})
    process.pump()
    assert process.marking("n") == {"t.active": 3}
    process.held.reverse()
    process.end("t")
    process.end("t", ImError("no"))
    process.end("t")
    assert process.marking("n") == {"b": 2, "bad": 1}


def test_a_net_without_actions_does_not_hold_the_loop():
    net = parse_net("net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b}, u: {in: b, out: a}}")
    executor = Process([net]).exchange.nets["n"]
    assert executor.pump(limit=10)
    assert executor.sequence == 10
    executor.pump(limit=10)
    assert executor.stretch == 20
    executor.post(GuardsChanged())
    executor.pump(limit=10)
    assert executor.stretch == 10, "what happens outside has been heard"


def test_an_unregistered_function_is_named_with_file_and_line(data):
    with pytest.raises(NetFileError, match=r"coordinator\.yaml:9: transitions\.search: no action function 'search'"):
        Process([load_net(data / "coordinator.yaml")], {"serch": hold})


def test_a_request_runs_through_the_coordination_structure_and_its_results_come_back(data):
    loops = [2]

    def prepare(ctx: ActionContext) -> None:
        ctx.progress("prepared", 0.1)

    def search(ctx: ActionContext) -> None:
        assert ctx.command.symbol == "inspect"
        assert ctx.request_arguments == {"where": "table"}
        ctx.result["spot"] = loops[0]
        loops[0] -= 1

    nets = [load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")]
    process = Process(nets, {"prepare": prepare, "search": search}, {"more": lambda ctx: loops[0] > 0})
    process.command("dispatcher", "inspect", where="table")
    served = ["accept.find", "search+", "search", "t_f.find", "return.find"]
    assert process.recorder.names("coordinator") == 2 * served
    assert process.recorder.names("dispatcher") == [
        *("begin+", "begin", "look+", "look", "again", "look+", "look", "finish")
    ]
    assert process.marking("dispatcher") == {"idle": 1}
    assert process.marking("coordinator") == {"SI": 1, "SO": 1}
    assert process.results[0].success
    assert process.recorder.progress == [("prepared", 0.1)]
    assert {firing.command_id for firing in process.recorder.firings} == {1}


def test_a_failure_travels_back_with_its_facts(data):
    def search(ctx: ActionContext) -> None:
        raise DataError("the spot was not found", camera="wall")

    nets = [load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")]
    process = Process(nets, {"prepare": lambda ctx: None, "search": search}, {"more": lambda ctx: False})
    process.command("dispatcher", "inspect")
    assert process.recorder.names("dispatcher")[-2:] == ["look!", "give_up"]
    assert not process.results[0].success
    assert process.results[0].error.facts == {"camera": "wall"}
    assert process.marking("coordinator") == {"SI": 1, "SO": 1}


def test_cancelling_a_command_reaches_the_action_that_runs_for_it_in_another_net(data):
    nets = [load_net(data / "dispatcher.yaml"), load_net(data / "coordinator.yaml")]
    process = Process(nets, {"prepare": lambda ctx: None, "search": hold}, {"more": lambda ctx: False})
    number = process.command("dispatcher", "inspect")
    waiting = process.command("dispatcher", "inspect")
    told: list[str] = []
    process.held[0][2].on_cancel(lambda: told.append("stop"))
    error = ImError("cancelled by its client", code="cancelled")
    process.exchange.nets["dispatcher"].post(CommandCancelled(waiting, error))
    process.exchange.nets["dispatcher"].post(CommandCancelled(number, error))
    process.pump()
    assert told == ["stop"]
    assert process.held[0][2].cancelled
    assert [result.error.code for result in process.results] == ["cancelled"]
    process.end("search", ImError("stopped", code="cancelled"))
    assert [result.success for result in process.results] == [False, False]
    assert process.marking("dispatcher") == {"idle": 1}


def test_an_object_that_loses_its_validity_moves_its_token():
    net = parse_net(
        """
net: n
places: {valid: {tokens: 1, data_object: {name: path, scope: global}, on_invalid: [stale]}, stale: , go: , moved: }
transitions: {move: {in: [valid, go], out: moved}}
"""
    )
    process = Process([net])
    process.exchange.nets["n"].post(ObjectInvalidated("other"))
    process.pump()
    assert process.marking("n") == {"valid": 1}
    process.exchange.nets["n"].post(ObjectInvalidated("path"))
    process.pump()
    assert process.marking("n") == {"stale": 1}
    assert process.recorder.names("n") == ["valid.withdrawn"]


def test_the_requests_of_two_services_are_answered_each_to_its_caller():
    server = parse_net(
        """
net: server
places: {one: , two: , did_one: , did_two: , broken: }
services:
  s1: {entry: one, done: did_one, failed: broken}
  s2: {entry: two, done: did_two, failed: broken}
transitions:
  do_one: {in: one, out: did_one, action: work, on_failure: broken}
  do_two: {in: two, out: did_two, action: fails, on_failure: broken}
"""
    )
    client = parse_net(
        """
net: client
places: {a: 1, b: 1, a_done: , b_done: , a_failed: , b_failed: }
transitions:
  ask_one: {in: a, out: a_done, request: {to: server.s1, arguments: {x: 1}}, on_failure: a_failed}
  ask_two: {in: b, out: b_done, request: server.s2, on_failure: b_failed}
"""
    )

    def fails(ctx: ActionContext) -> None:
        raise ImError("two never works")

    for seed in range(8):
        process = Process([server, client], {"work": lambda ctx: None, "fails": fails}, seed=seed)
        process.pump()
        assert process.marking("client") == {"a_done": 1, "b_failed": 1}
        assert process.marking("server") == {"SI": 1, "SO": 1}


def test_an_action_with_two_servers_works_on_two_tokens_until_one_ends_either_way():
    net = parse_net(
        "net: n\nplaces: {a: 4, b: , c: }\ntransitions:\n"
        "  t: {in: a, out: b, action: f, on_failure: c, servers: 2, timeout: 5.0}"
    )
    process = Process([net], {"f": hold})
    process.pump()
    executor = process.exchange.nets["n"]
    assert process.marking("n") == {"a": 2, "t.active": 2}
    assert executor.hindrance("t.start") == "place t.servers holds 0 tokens, and it takes 1"
    process.end("t")
    assert process.marking("n") == {"a": 1, "b": 1, "t.active": 2}
    process.end("t", NetError("no"))
    process.end("t")
    process.end("t")
    assert process.marking("n") == {"b": 3, "c": 1, "t.servers": 2}


def test_a_net_says_why_it_is_not_at_rest():
    net = parse_net(
        "net: n\nplaces: {idle: 1, a: }\n"
        "transitions:\n  t: {in: idle, out: a, symbol: s, action: f, on_failure: idle}\n"
        "  u: {in: a, out: idle, emit: s_done}"
    )
    process = Process([net], {"f": hold})
    executor = process.exchange.nets["n"]
    assert executor.at_rest()
    assert str(executor.at_rest()) == "at rest"
    process.command("n", "s")
    assert executor.at_rest().reasons == (
        "function f of transition t is active",
        "command s (number 1) is open",
    )
    process.end("t")
    assert executor.at_rest()


def test_what_a_job_keeps_in_memory_is_found_by_its_later_actions_and_not_by_its_caller():
    net = parse_net(
        "net: n\nplaces: {idle: 1, a: , b: }\ntransitions:\n"
        "  t: {in: idle, out: a, symbol: s, action: keeps, on_failure: idle}\n"
        "  u: {in: a, out: idle, action: finds, on_failure: b, emit: s_done}\n"
        "  v: {in: b, out: idle, emit: s_failed}"
    )

    def keeps(ctx: ActionContext) -> None:
        assert ctx.memory == {}
        ctx.memory["poses"] = [1, 2]

    def finds(ctx: ActionContext) -> None:
        ctx.result["sum"] = sum(ctx.memory["poses"])

    process = Process([net], {"keeps": keeps, "finds": finds})
    for _ in range(2):
        process.command("n", "s")
    assert [result.results for result in process.results] == [{"sum": 3}, {"sum": 3}]


def test_a_command_that_its_net_forgets_is_ended_when_the_net_comes_to_rest():
    net = parse_net(
        "net: n\nplaces: {idle: 1, a: }\ntransitions: {t: {in: idle, out: a, symbol: s}, u: {in: a, out: idle}}"
    )
    process = Process([net])
    process.command("n", "s")
    assert "emitted neither s_done nor s_failed" in str(process.results[0].error)


def serving(at_once: int) -> Process:
    """Three callers of a net that serves some of their requests at once."""
    server = parse_net(
        f"""
net: server
at_once: {at_once}
places: {{asked: , told: , refused: }}
services: {{work: {{entry: asked, done: told, failed: refused}}}}
transitions: {{work: {{in: asked, out: told, action: work, on_failure: refused}}}}
"""
    )
    boss = parse_net(
        """
net: boss
places: {idle: 3, asked: , bad: }
transitions:
  ask: {symbol: go, in: idle, out: asked, request: {to: server.work, arguments: {}}, on_failure: bad}
  done: {in: asked, out: idle, emit: go_done}
  failed: {in: bad, out: idle, emit: go_failed}
"""
    )
    process = Process([server, boss], {"work": hold})
    for _ in range(3):
        process.command("boss", "go")
    return process


@pytest.mark.parametrize("at_once", [1, 2, 3])
def test_a_net_serves_as_many_requests_at_once_as_it_says(at_once):
    process = serving(at_once)
    assert [context.command.id for _, _, context in process.held] == list(range(1, at_once + 1))
    while process.held:
        process.end("work")
    assert [result.success for result in process.results] == [True] * 3
    assert process.marking("server") == {"SI": at_once, "SO": 1}


def test_of_requests_served_at_once_each_gets_its_own_answer():
    process = serving(2)
    owner, activity, _ = process.held.pop(1)
    owner.ended(activity, ImError("no", code="no"))
    process.pump()
    assert [str(result.error) for result in process.results] == ["no"]
    assert [context.command.id for _, _, context in process.held] == [1, 3]
    while process.held:
        process.end("work")
    assert [result.success for result in process.results] == [False, True, True]
