"""Nobody acts on what he does not hold: what is refused, in which words, and that no net is let through that does."""

import random

import pytest

from im_core.clock import thread_cpu
from im_core.errors import ImError
from im_pnt.execution.events import CommandCancelled
from im_pnt.model.net import Net
from im_pnt.netfile import parse_net
from im_pnt_analysis.composition.resource_proof import unheld
from im_pnt_analysis.verify.load import verify_to_load
from im_pnt_analysis.verify.verdict import verify
from support.process import Process, hold

MOVER = """
net: mover
places: {asked: , moved: , refused: }
services:
  move:
    entry: asked
    done: moved
    failed: refused
    arguments: {group: {type: string, choices: [left, right]}, cameras: {type: strings, default: []}}
    acts_on: ["${arguments.group}_arm", "${arguments.cameras}"]
transitions:
  go: {in: asked, out: moved, action: go, on_failure: refused}
"""
PICK = """
net: pick
commands:
  pick:
    needs: NEEDS
    arguments: {group: {type: string, choices: [left, right]}, VIEW}
places: {idle: {tokens: 2, resource: true}, wanted: , done: , failed: }
transitions:
  begin: {symbol: pick, in: idle, out: wanted}
  go:
    in: wanted
    GUARD
    out: done
    request: {to: mover.move, ARGUMENTS}
    on_failure: failed
  tell: {in: done, out: idle, emit: pick_done}
  give_up: {in: failed, out: idle, emit: pick_failed}
"""


def pick(needs: str, arguments: str, guard: str = "") -> Net:
    view = "view: {type: string, choices: [wall, table], default: wall}"
    text = PICK.replace("VIEW", view).replace("NEEDS", needs).replace("ARGUMENTS", arguments)
    if guard:
        text += "  leave: {in: wanted, out: failed, guard: otherwise}\n"
    return parse_net(text.replace("GUARD", guard and f"guard: {guard}"), "pick.yaml")


OWN_ARM = 'arguments: {group: "${arguments.group}"}'


@pytest.mark.parametrize(
    ("needs", "arguments", "guard"),
    [
        ('["${arguments.group}_arm"]', OWN_ARM, ""),
        ("[left_arm]", "arguments: {group: left}", ""),
        ('["${arguments.group}_arm"]', "arguments: {group: left}", "${arguments.group == 'left'}"),
        ('["${arguments.group}_arm", wall, table]', 'arguments: {group: left, cameras: ["${arguments.view}"]}',
         "not ${arguments.group == 'right'}"),
        ("[left_arm, right_arm]", "build: made", ""),
    ],
)  # fmt: skip
def test_who_holds_what_he_acts_on_may(needs, arguments, guard):
    report = verify([pick(needs, arguments, guard), parse_net(MOVER)])
    if "build" in arguments:
        assert [case.kind for case in report.refusals] == ["unheld"]  # cameras: anything
        assert "cameras" in report.refusals[0].reason
        assert "'made'" in report.refusals[0].reason
    else:
        assert report.ok, report.refusals
        assert report.resources_held


@pytest.mark.parametrize(
    ("needs", "arguments", "sentence"),
    [
        ("[]", OWN_ARM, "pick.yaml:10: transition go of net pick acts on left_arm, right_arm, which command pick does "
                        "not hold; it holds nothing"),
        ('["${arguments.group}_arm"]', "arguments: {group: left}",
         "pick.yaml:10: transition go of net pick acts on left_arm, which command pick with group=right does not "
         "hold; it holds right_arm"),
        ('["${arguments.group}_arm", wall]',
         'arguments: {group: "${arguments.group}", cameras: ["${arguments.view}"]}',
         "pick.yaml:10: transition go of net pick acts on table, which command pick with group=left does not hold; "
         "it holds left_arm, wall"),
    ],
)  # fmt: skip
def test_who_acts_on_what_he_does_not_hold_is_refused_with_the_way_there(needs, arguments, sentence):
    nets = [pick(needs, arguments), parse_net(MOVER)]
    for report in (verify(nets), verify_to_load(nets)):
        assert not report.ok
        case = next(case for case in report.refusals if case.kind == "unheld")
        assert case.reason == sentence
        assert case.sequence == ("pick.begin", "pick.go.start")
        assert case.marking == {"pick.wanted": 1}


ALONE = """
net: alone
commands: {job: {needs: [tool]}}
places: {idle: {tokens: 2, resource: true}, one: , two: , three: , trouble: }
escalate: trouble
transitions:
"""


@pytest.mark.parametrize(
    ("transitions", "sentence", "sequence"),
    [
        (
            """
  begin: {symbol: job, in: idle, out: [one, two]}
  tell: {in: one, emit: job_done}
  work: {in: two, out: idle, action: work, acts_on: tool}
  clear: {in: trouble, out: idle}""",
            "transition work of net alone acts on tool when command job has ended, which held it",
            ("begin", "work.start", "tell"),
        ),
        (
            """
  begin: {symbol: job, in: idle, out: one, emit: job_done}
  work: {in: one, out: idle, action: work, acts_on: tool}
  clear: {in: trouble, out: idle}""",
            "transition work of net alone acts on tool for nobody",
            ("begin", "work.start"),
        ),
        (
            """
  begin: {symbol: job, in: idle, out: one, action: work, acts_on: tool}
  tell: {in: one, out: idle, emit: job_done}
  stop: {symbol: {name: stop, of: nobody}, in: idle, out: idle, action: stop, acts_on: tool}
  clear: {in: trouble, out: idle, emit: job_failed}""",
            "transition stop of net alone acts on tool for nobody",
            ("stop.start",),
        ),
    ],
)
def test_who_has_ended_holds_nothing(transitions, sentence, sequence):
    report = verify([parse_net(ALONE + transitions, "alone.yaml")])
    (case,) = [case for case in report.refusals if sentence in case.reason]
    assert (case.kind, case.sequence) == ("unheld", sequence)


KEEPER = """
net: keeper
commands: {pick: {arguments: {group: {type: string, choices: [left, right]}}}}
places: {left_arm: {tokens: 1, resource: true}, right_arm: {tokens: 1, resource: true}, failed: }
transitions:
  pick_left:
    symbol: pick
    in: left_arm
    out: GIVES
    request: {to: pick.pick, arguments: {group: left}}
    emit: pick_done
    on_failure: failed
  give_back: {in: failed, out: left_arm, emit: pick_failed}
"""


def test_the_net_that_has_the_resource_holds_it_while_its_token_is_taken():
    nets = [pick('["${arguments.group}_arm"]', OWN_ARM), parse_net(MOVER)]
    keeper = KEEPER.replace("GIVES", "left_arm")
    assert unheld([parse_net(keeper), *nets], thread_cpu() + 10.0) == []
    right = keeper.replace("in: left_arm\n", "in: right_arm\n").replace("out: left_arm\n", "out: right_arm\n")
    wrong = parse_net(right)
    (case,) = unheld([wrong, *nets], thread_cpu() + 10.0)
    assert "transition pick_left of net keeper acts on left_arm, which command pick does not hold" in case.reason
    twice = parse_net(keeper.replace("left_arm: {tokens: 1", "left_arm: {tokens: 2"))
    assert len(unheld([twice, *nets], thread_cpu() + 10.0)) == 1
    places, transitions = "{left_arm: {tokens: 1, resource: true}}", "{t: {symbol: s, in: left_arm, out: left_arm}}"
    other = parse_net(f"net: other\nplaces: {places}\ntransitions: {transitions}")
    assert len(unheld([parse_net(keeper), *nets, other], thread_cpu() + 10.0)) == 1  # whose arm is it?


# Random nets, played by the engine itself.


def a_net(dice: random.Random) -> Net:
    """A net with a command that holds the tool and one that does not, forks, joins, ends, failures and leftovers."""
    inner = [f"p{number}" for number in range(dice.randint(2, 5))]
    lines = ["net: net", "commands: {a: {needs: [tool]}, b: {}}"]
    lines.append(f"places: {{idle: {{tokens: 9, resource: true}}, trouble: , {', '.join(f'{p}: ' for p in inner)}}}")
    lines += ["escalate: trouble", "transitions:"]
    for number in range(dice.randint(3, 7)):
        begins = number < 2
        takes = dice.sample(inner, dice.choice((1, 1, 1, 2))) if not begins else ["idle"]
        later = inner if begins else [place for place in inner if place > max(takes)]  # so that all comes to an end
        gives = dice.sample(later, min(len(later), dice.randint(1 if begins else 0, 2)))
        keys = [f"in: [{', '.join(takes)}]", f"out: [{', '.join(gives)}]"]
        if begins:
            keys.append(f"symbol: {'ab'[number]}")
        kind = dice.random()
        if kind < 0.35:
            keys.append("action: work, acts_on: tool")
        elif kind < 0.55:
            keys.append("action: work")
        if dice.random() < 0.4:
            keys.append(f"emit: {dice.choice(('a_done', 'a_failed', 'b_done', 'a_done'))}")
        lines.append(f"  t{number}: {{{', '.join(keys)}}}")
    lines.append(f"  clear: {{in: trouble, emit: {dice.choice(('a_failed', 'b_failed'))}}}")
    return parse_net("\n".join(lines))


def acts_unheld(process: Process) -> bool:
    """Whether an action that runs acts on the tool for somebody who does not hold it."""
    ledger = process.exchange.nets["net"].rule.ledger
    for _, activity, _ in process.held:
        if process.exchange.nets["net"].written.transitions[activity.transition].acts_on:
            job = activity.lineage.job
            if job is None or not ledger.is_open(job) or job.symbol != "a":
                return True
    return False


def play(net: Net, dice: random.Random) -> bool:
    """Plays a net at random; returns whether somebody acted on what he did not hold."""
    process = Process([net], {"work": hold}, seed=dice.randrange(1000))
    for number in range(12):
        choice = dice.random()
        if choice < 0.35 or not process.held:
            process.command("net", dice.choice("aab"))
        elif choice < 0.9:
            _, activity, _ = dice.choice(process.held)
            process.end(activity.transition, ImError("no", code="no") if dice.random() < 0.3 else None)
        else:
            off = ImError("off", code="cancelled")
            process.exchange.nets["net"].post(CommandCancelled(dice.randint(1, number + 1), off))
            process.pump()
        if acts_unheld(process):
            return True
    return False


def test_no_random_net_that_is_let_through_acts_on_what_is_not_held():
    accepted = refused = shown = 0
    for seed in range(80):
        dice = random.Random(seed)
        net = a_net(dice)
        cases = unheld([net], thread_cpu() + 60.0)
        wrong = any(play(net, dice) for _ in range(5))
        assert cases or not wrong, (seed, cases)
        accepted, refused, shown = accepted + (not cases), refused + bool(cases), shown + wrong
    assert accepted > 10
    assert refused > 20
    assert shown > 0.6 * refused  # what is refused is not refused for nothing


def test_a_token_of_another_nets_command_may_not_let_act_what_that_does_not_hold():
    text = """
net: welder
commands: {weld: {needs: [torch]}}
places: {part: {remote: true}, welded: }
transitions:
  weld: {symbol: weld, in: part, out: welded, action: weld, acts_on: [torch], on_failure: welded}
  away: {in: welded, emit: weld_done}
"""
    (case,) = unheld([parse_net(text)], thread_cpu() + 10)
    assert "acts on torch, which a command of another net, whose tokens come here, does not hold" in case.reason
    assert unheld([parse_net(text.replace("remote: true", "remote: true, resource: true"))], thread_cpu() + 10) == []


CALLS = [
    ("service: {name: /arm/on, type: std_srvs/srv/Trigger}", "service /arm/on"),
    ("goal: {name: /arm/go, type: p/action/Go}", "goal /arm/go"),
    ("topic: {name: /arm/say, type: std_msgs/msg/String}", "topic /arm/say"),
]
CALLER = """
net: caller
commands: {pick: {needs: NEEDS}}
places: {idle: {tokens: 1, resource: true}, done: }
transitions:
  go: {symbol: pick, in: idle, out: done, CALL, ACTS on_failure: done}
  tell: {in: done, out: idle, emit: pick_done}
"""


def caller(call: str, needs: str = "[left_arm]", acts: str = "") -> Net:
    text = CALLER.replace("CALL", call).replace("NEEDS", needs).replace("ACTS", acts)
    return parse_net(text, "caller.yaml")


@pytest.mark.parametrize(("call", "shown"), CALLS)
def test_where_resources_are_spoken_of_who_tells_the_world_something_says_what_that_acts_on(call, shown):
    report = verify([caller(call)])
    (case,) = report.refusals
    assert (case.kind, case.sequence) == ("unheld", ())
    assert case.reason == (
        f"caller.yaml:6: transition go of net caller does not say what its {shown} acts on: declare `acts_on`, "
        "[] for nothing"
    )
    assert verify([caller(call, acts="acts_on: [],")]).ok
    assert verify([caller(call, acts="acts_on: left_arm,")]).ok
    (case,) = verify([caller(call, acts="acts_on: right_arm,")]).refusals
    assert "acts on right_arm, which command pick does not hold; it holds left_arm" in case.reason


@pytest.mark.parametrize(("call", "_"), CALLS)
def test_where_nobody_speaks_of_resources_nobody_needs_to_say_what_he_acts_on(call, _):
    assert verify([caller(call, needs="[]")]).ok


def test_one_net_that_speaks_of_resources_makes_those_that_it_talks_to_say_what_they_act_on():
    silent = MOVER.replace("action: go", "service: {name: /arm/go, type: std_srvs/srv/Trigger}")
    silent = silent.replace('    acts_on: ["${arguments.group}_arm", "${arguments.cameras}"]\n', "")
    assert verify([parse_net(silent)]).ok
    nets = [pick('["${arguments.group}_arm"]', OWN_ARM), parse_net(silent, "mover.yaml")]
    for report in (verify(nets), verify_to_load(nets)):
        (case,) = report.refusals
        assert case.reason.startswith("mover.yaml:11: transition go of net mover does not say what its service /arm/go")


LOOKER = """
net: looker
places: {asked: , seen: , missed: }
services:
  look:
    entry: asked
    done: seen
    failed: missed
    arguments: {cameras: {type: strings, LIMITS}}
    acts_on: ["${arguments.cameras}"]
transitions:
  see: {in: asked, out: seen, ACTION, on_failure: missed}
"""
EYE = LOOKER.replace("looker", "eye").replace("ACTION", 'action: see, acts_on: ["${arguments.cameras}"]')


@pytest.mark.parametrize("limits", ["length: [0, 9]", "choices: [wall, table]"])
def test_what_is_held_as_a_list_may_be_acted_on_as_that_list_and_not_as_an_element_that_it_may_lack(limits):
    looker, eye = LOOKER.replace("LIMITS", limits), parse_net(EYE.replace("LIMITS", limits))

    def cases(action: str) -> list[str]:
        nets = [parse_net(looker.replace("ACTION", action)), eye]
        return [case.reason for case in unheld(nets, thread_cpu() + 10) or ()]

    assert cases('action: see, acts_on: ["${arguments.cameras}"]') == []
    assert cases("request: eye.look") == []
    assert cases('request: {to: eye.look, arguments: {cameras: "${arguments.cameras}"}}') == []
    (reason,) = cases("action: see, acts_on: [wall]")
    assert "acts on wall, which request look does not hold; it holds ${arguments.cameras}" in reason
    (reason,) = cases('request: {to: eye.look, arguments: {cameras: ["wall"]}}')
    assert "acts on wall, which request look does not hold; it holds ${arguments.cameras}" in reason
