from im_pnt.execution.events import (
    BreakpointSet,
    Confirmed,
    GuardsChanged,
    ModeSet,
    PauseSet,
    StepAsked,
    TokenArrived,
)
from im_pnt.execution.operator import Mode
from im_pnt.netfile import parse_net
from support.process import Clock, Process, hold

NET = """
net: n
places: {a: 1, b: , c: , d: , bad: }
transitions:
  left: {in: a, out: b}
  right: {in: a, out: c}
  act: {in: b, out: d, action: f, on_failure: bad}
  back: {in: [d], out: a}
"""


def process(mode: Mode | None = None, text: str = NET, **kwargs) -> Process:
    made = Process([parse_net(text)], {"f": hold}, **kwargs)
    if mode is not None:
        post(made, ModeSet(mode))
    return made


def post(made: Process, event) -> None:
    made.exchange.nets["n"].post(event)
    made.pump()


def test_supervised_every_firing_waits_for_its_confirmation_and_the_operator_resolves_conflicts():
    made = process(Mode.SUPERVISED)
    assert made.marking("n") == {"a": 1}
    assert made.recorder.operation == [(Mode.SUPERVISED, False, ("left", "right"))]
    post(made, Confirmed("left"))
    assert made.marking("n") == {"b": 1}
    assert made.exchange.nets["n"].proposed == ("act",)
    post(made, Confirmed("right"))
    assert "right was confirmed, but it is not proposed" in made.recorder.troubles[0]
    post(made, Confirmed("act"))
    made.end("act")
    assert made.marking("n") == {"d": 1}
    assert made.exchange.nets["n"].proposed == ("back",)


def test_supervised_a_lower_priority_is_not_proposed_before_the_higher_one_is_gone():
    made = process(
        Mode.SUPERVISED, NET.replace("right: {in: a,", "right: {priority: 1, in: a,").replace("a: 1", "a: 2")
    )
    assert made.exchange.nets["n"].proposed == ("right",)
    post(made, Confirmed("left"))
    assert made.marking("n") == {"a": 2}


def test_a_proposal_whose_guard_has_changed_its_mind_is_withdrawn():
    allowed = [True]
    text = "net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, guard: g}}"
    made = Process([parse_net(text)], guards={"g": lambda ctx: allowed[0]})
    post(made, ModeSet(Mode.SUPERVISED))
    assert made.exchange.nets["n"].proposed == ("t",)
    allowed[0] = False
    post(made, GuardsChanged())
    assert made.exchange.nets["n"].proposed == ()
    allowed[0] = True
    post(made, GuardsChanged())
    allowed[0] = False
    post(made, Confirmed("t"))
    assert made.marking("n") == {"a": 1}
    assert "cannot fire any more" in made.recorder.troubles[0]


def test_leaving_the_supervised_mode_lets_the_net_go_on():
    made = process(Mode.SUPERVISED)
    post(made, ModeSet(Mode.AUTOMATIC))
    assert made.marking("n") in ({"act.active": 1}, {"c": 1})
    assert made.recorder.operation[-1] == (Mode.AUTOMATIC, False, ())


def test_a_step_is_one_firing():
    made = process(Mode.STEP, NET.replace("right: {in: a, out: c}", "right: {in: c, out: c}"))
    assert made.marking("n") == {"a": 1}
    post(made, StepAsked())
    assert made.marking("n") == {"b": 1}
    post(made, StepAsked())
    assert made.marking("n") == {"act.active": 1}
    post(made, StepAsked())
    made.end("act")
    assert made.marking("n") == {"d": 1}
    assert made.recorder.names("n") == ["left", "act+", "act"]


def test_a_pause_starts_nothing_new_in_whatever_mode():
    made = process()
    post(made, PauseSet(True))
    post(made, ModeSet(Mode.STEP))
    post(made, StepAsked())
    post(made, ModeSet(Mode.SUPERVISED))
    post(made, Confirmed("left"))
    assert made.marking("n") == {"a": 1}
    assert made.exchange.nets["n"].proposed == ()
    assert made.exchange.nets["n"].paused


def test_in_a_pause_what_runs_goes_on():
    made = process(text=NET.replace("right: {in: a, out: c}", "right: {in: c, out: c}"))
    made.pump()
    post(made, PauseSet(True))
    made.end("act")
    assert made.marking("n") == {"d": 1}
    post(made, PauseSet(False))
    assert made.marking("n") == {"act.active": 1}


def test_a_pause_accepts_no_request_and_answers_the_one_in_work():
    server = parse_net(
        "net: server\nplaces: {in: , out: , bad: }\nservices: {s: {entry: in, done: out, failed: bad}}\n"
        "transitions: {work: {in: in, out: out, action: f, on_failure: bad}}"
    )
    client = parse_net(
        "net: client\nplaces: {a: 2, b: , bad: }\n"
        "transitions: {ask: {in: a, out: b, request: server.s, on_failure: bad}}"
    )
    made = Process([server, client], {"f": hold})
    made.pump()
    made.exchange.nets["server"].post(PauseSet(True))
    made.pump()
    made.end("work")
    assert made.marking("server") == {"I.s": 1, "SI": 1, "SO": 1}
    made.exchange.nets["server"].post(PauseSet(False))
    made.pump()
    made.end("work")
    assert made.marking("client") == {"b": 2}


def test_a_delayed_transition_waits_for_the_operator_when_its_time_is_over():
    text = "net: n\nplaces: {a: 1, b: }\ntransitions: {t: {in: a, out: b, delay: 2}}"
    made = process(Mode.SUPERVISED, text, clock=Clock())
    assert made.exchange.nets["n"].proposed == ()
    made.wait(2.0)
    assert made.exchange.nets["n"].proposed == ("t",)
    post(made, Confirmed("t"))
    assert made.marking("n") == {"b": 1}


LINE = """
net: n
places: {idle: 1, a: , b: , done: }
transitions:
  begin: {in: idle, out: a, symbol: go}
  act: {in: a, out: b, action: f, on_failure: idle}
  end: {in: b, out: idle, emit: go_done}
"""


def test_a_command_waits_at_a_breakpoint_each_time_until_it_is_confirmed_and_goes_on_when_it_is_cleared():
    made = process(text=LINE)
    net = made.exchange.nets["n"]
    post(made, BreakpointSet("act", True))
    assert made.recorder.breakpoints[-1] == ("act",)
    for _ in range(2):
        made.command("n", "go")
        assert made.marking("n") == {"a": 1}
        assert net.proposed == ("act",)
        post(made, Confirmed("act"))
        assert made.marking("n") == {"act.active": 1}
        made.end("act")
        assert made.marking("n") == {"idle": 1}
    made.command("n", "go")
    assert net.proposed == ("act",)
    post(made, BreakpointSet("act", False))
    assert made.marking("n") == {"act.active": 1}
    assert made.recorder.operation[-1] == (Mode.AUTOMATIC, False, ())
    assert made.recorder.breakpoints[-1] == ()


def test_what_contends_with_a_breakpoint_may_take_the_token_meanwhile():
    made = process(text="net: n\nplaces: {a: , b: , c: }\ntransitions: {t: {in: a, out: b}, u: {in: a, out: c}}")
    post(made, BreakpointSet("t", True))
    post(made, TokenArrived("a", 1))
    assert made.marking("n") == {"c": 1}


def test_a_breakpoint_holds_no_step_and_no_pause_up():
    made = process(Mode.STEP, LINE)
    post(made, BreakpointSet("act", True))
    made.command("n", "go")
    post(made, StepAsked())
    assert made.marking("n") == {"a": 1}
    post(made, StepAsked())
    assert made.exchange.nets["n"].proposed == ("act",)
    post(made, PauseSet(True))
    assert made.exchange.nets["n"].proposed == ()
    post(made, PauseSet(False))
    post(made, Confirmed("act"))
    assert made.marking("n") == {"act.active": 1}


def test_a_command_forgotten_by_its_net_ends_also_where_there_is_a_breakpoint():
    made = process(text=LINE.replace(", emit: go_done", ""))
    post(made, BreakpointSet("begin", True))
    made.command("n", "go")
    post(made, Confirmed("begin"))
    made.end("act")
    assert "neither go_done nor go_failed" in made.results[0].error.message
