"""Values in nets: where they may stand, what is refused at load, and how they flow from action to action."""

import contextlib
import re
from typing import ClassVar

import pytest

from im_core.errors import DataError, ImError, NotFoundError
from im_pnt.errors import NetError, NetFileError
from im_pnt.execution.events import GuardsChanged
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity, Command
from im_pnt.execution.values import ObjectPendingError, run_at_once
from im_pnt.expression.scope import NetScope, check_net
from im_pnt.expression.template import read_answers
from im_pnt.expression.types import ANY, BOOLEAN, NUMBER, NoTypes, ValueType, field_type, list_of, message_type
from im_pnt.model.action import ServiceAction, TopicAction, ValuesAction
from im_pnt.model.net import Guard
from im_pnt.netfile import parse_net, yaml_text
from im_pnt_analysis.verify.verdict import verify
from support.journalled import JournalledProcess
from support.memory_files import MemoryFiles
from support.process import Process

NET = """\
net: n
commands:
  pick:
    arguments:
      width: {type: number, unit: m}
      group: {type: string, default: left}
      least: {type: integer, default: 2}
places:
  idle: {tokens: 1, resource: true}
  asked: {data_object: {name: spot, type: p_msgs/msg/Spot}}
  looked:
  told:
  done:
  bad:
escalate: bad
transitions:
  look:
    symbol: pick
    in: idle
    out: looked
    service:
      name: /look
      type: p_msgs/srv/Look
      request: {width: "${arguments.width / 2}", name: "${arguments.group}_arm"}
  tell:
    in: looked
    out: told
    guard: ${len(answers.look.spots) >= arguments.least and answers.look.found}
    topic: {name: /tell, type: p_msgs/msg/Word, message: {data: "x is ${answers.look.spots[0].x}", many: 3}}
  skip:
    in: looked
    out: told
    guard: not ${len(answers.look.spots) >= arguments.least and answers.look.found}
  note: {in: told, out: done, result: {spots: "${answers.look.spots}", by: "${command.symbol} ${command.id}"}}
  end: {in: done, out: idle, emit: pick_done}
  fail: {in: bad, out: idle, emit: pick_failed}
"""


class Types:
    """Types of messages that are made up."""

    known: ClassVar = {
        "p_msgs/srv/Look_Request": {"width": "double", "name": "string<8>", "pose": "p_msgs/Spot"},
        "p_msgs/srv/Look_Response": {"found": "boolean", "spots": "sequence<p_msgs/Spot>", "error": "double"},
        "p_msgs/msg/Spot": {"x": "double", "name": "string"},
        "p_msgs/msg/Word": {"data": "string", "many": "uint8", "flags": "boolean[2]"},
    }

    def fields(self, message: str) -> dict[str, ValueType]:
        if message not in self.known:
            raise NotFoundError(kind="type", name=message, known=self.known)
        return {name: field_type(text) for name, text in self.known[message].items()}


SPOTS = [{"x": 0.5, "name": "a"}, {"x": 1.5, "name": "b"}]


class Machine:
    """A process whose services answer as a test says."""

    def __init__(self, text: str, answer: dict[str, object] | ImError, **more: object) -> None:
        self.answer, self.sent = answer, list[tuple[str, object]]()
        self.begun = list[Activity]()
        self.contexts = list[ActionContext]()
        others = {ServiceAction: self.perform, TopicAction: self.perform}
        self.process = Process([parse_net(text)], others=others, **more)

    async def perform(self, activity, context):
        self.sent.append((activity.transition, await context.filled(activity.action.fields)))
        self.begun.append(activity)
        self.contexts.append(context)
        if isinstance(self.answer, ImError):
            raise self.answer
        return self.answer if isinstance(activity.action, ServiceAction) else {}


def test_a_net_in_yaml_alone_calls_with_arguments_keeps_an_answer_looks_at_it_sends_it_on_and_returns_it():
    machine = Machine(NET, {"found": True, "spots": SPOTS})
    number = machine.process.command("n", "pick", width=0.1)
    assert machine.sent == [
        ("look", {"width": 0.05, "name": "left_arm"}),
        ("tell", {"data": "x is 0.5", "many": 3}),
    ]
    assert machine.process.results[0].results == {"spots": SPOTS, "by": f"pick {number}"}
    machine.process.command("n", "pick", width=0.1, least=3)
    assert machine.process.recorder.names("n")[-4:] == ["skip", "note+", "note", "end"]
    machine.answer = {"found": False, "spots": SPOTS}
    machine.process.command("n", "pick", width=0.1)
    assert machine.process.recorder.names("n")[-4:] == ["skip", "note+", "note", "end"]


def test_what_is_read_of_answers_is_known_and_no_more():
    assert read_answers(parse_net(NET)) == {"look": (("found",), ("spots",))}
    less = NET.replace('{spots: "${answers.look.spots}", by', "{by").replace(
        "len(answers.look.spots) >= arg", "2 >= arg"
    )
    assert read_answers(parse_net(less)) == {"look": (("found",), ("spots", "x"))}


def test_a_value_that_is_not_there_fails_the_action_in_a_sentence():
    text = NET.replace("answers.look.spots}", "answers.look.spots[5]}")
    machine = Machine(text, {"found": True, "spots": SPOTS})
    machine.process.command("n", "pick", width=0.1)
    result = machine.process.results[0]
    assert not result.success
    assert result.error.code == "expression"
    assert str(result.error) == (
        "transition note of net n: answers.look.spots has 2 elements, and no element 5; the first is 0"
    )
    zero = NET.replace("arguments.width / 2", "arguments.width / 0")
    machine = Machine(zero, {})
    machine.process.command("n", "pick", width=0.1)
    assert str(machine.process.results[0].error) == "transition look of net n: (arguments.width / 0) divides by 0"


def test_values_of_a_net_are_written_as_they_were_read():
    net = parse_net(NET)
    again = parse_net(yaml_text(net))
    assert again.transitions["tell"].guard == net.transitions["tell"].guard
    assert again.transitions["skip"].guard == Guard(net.transitions["tell"].guard.name, negated=True)
    assert again.transitions["note"].result == net.transitions["note"].result
    assert again.transitions["note"].action == ValuesAction()


def test_a_guard_and_its_negation_are_complementary_in_verification():
    report = verify([parse_net(NET)])
    assert report.ok
    assert not any("becomes true" in text for text in report.assumptions)
    alone = parse_net(NET.replace("guard: not ${len", "guard: ${len"))
    with pytest.raises(NetError, match="nothing fires at 'looked'"):
        verify([alone])


def test_arguments_are_those_of_whom_a_transition_works_for():
    text = NET.replace("commands:\n", "commands:\n  drop: {arguments: {width: {type: integer}}}\n")
    text += "  drop: {symbol: drop, in: idle, out: told}\n"
    net = parse_net(
        text.replace(', by: "${command.symbol} ${command.id}"', "")
        .replace("spots: ", "w: ")
        .replace('"${answers.look.spots}"', '"${arguments.width}"')
    )
    scope = NetScope(net, NoTypes())
    assert scope.works_for(net.transitions["tell"]) == {"pick"}
    assert scope.works_for(net.transitions["note"]) == {"pick", "drop"}
    assert scope.meanings(net.transitions["note"]).arguments("width") == NUMBER
    with pytest.raises(NetFileError, match=r"arguments.group: drop, served here, has no such argument \(kn"):
        parse_net(text.replace("${answers.look.spots}", "${arguments.group}"))


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("arguments.width / 2", "arguments.wdth / 2", r"net:24:24: transitions.look.service.request.width: arguments"
         r".wdth: pick, served here, has no such argument \(did you mean 'width'\?\)"),
        ("arguments.width / 2", "arguments.width /", "net:24:24: .*a value is missing at its end"),
        ("arguments.width / 2}", "arguments.width / 2", r"net:24:24: .* has no closing '\}'"),
        ("arguments.width / 2", "arguments.group", r"'\$\{arguments.group\}' is a text, not a number"),
        ("width: \"${arguments.width / 2}\"", "width: wide", "request.width: 'wide' is not a number"),
        ("width: \"${arguments.width / 2}\"", "widht: 1", r"look.service.request.widht: p_msgs/srv/Look_Request has no "
         r"field 'widht' \(did you mean 'width'\?\)"),
        ("name: \"${arguments.group}_arm\"", "name: much_too_long", "'much_too_long' is not a text of at most 8 char"),
        ("name: \"${arguments.group}_arm\"", "pose: {x: 1, y: 2}", "request.pose.y: p_msgs/msg/Spot has no field 'y'"),
        ("name: \"${arguments.group}_arm\"", "pose: 5", "request.pose: '5' is not p_msgs/msg/Spot"),
        ("type: p_msgs/srv/Look\n", "type: p_msgs/srv/Loook\n", "net:23:13: .*look.service.type: there is no type"),
        ("and answers.look.found", "and answers.look.fond", r"net:28:12: transitions.tell.guard: p_msgs/srv/Look_Respo"
         r"nse has no field 'fond' \(did you mean 'found'"),
        ("and answers.look.found", "and answers.look.error", "'and' is for what is true or false; answers.look.er"),
        ("and answers.look.found", "and answers.lok.found", r"no transition 'lok' \(did you mean 'look'"),
        ("and answers.look.found", "and answers.end.found", r"transition 'end' is not answered \(known: look\)"),
        ("and answers.look.found", "and data.spot.x", "'and' is for what is true or false; data.spot.x is a number"),
        ("and answers.look.found", "and data.sport.x > 1", r"data.sport: .*name: sport.* \(did you mean 'spot'"),
        ("${len(answers.look.spots) >= arguments.least and answers.look.found}", "${len(answers.look.spots)}",
         "is a whole number, not true or false"),
        ("many: 3", "many: 256", "tell.topic.message.many: '256' is not a whole number from 0 to 255"),
        ("many: 3", "many: -1", "'-1' is not a whole number from 0 to 255"),
        ("many: 3", "many: 1.5", "'1.5' is not a whole number from 0 to 255"),
        ("many: 3", "flags: [true]", "message.flags: a list of 1 is not a list of 2 truth values"),
        ("many: 3", "flags: [true, 1]", r"message.flags\[1\]: '1' is not true or false"),
        ("many: 3", "data2: true", "has no field 'data2'"),
        ("x is ${answers.look.spots[0].x}", "${answers.look.spots[0].x}", "is a number, not a text"),
        ("many: 3", "many: null", "message.many: nothing is not a whole number"),
        ("result: {spots", "store: {spot: {x: wide}}, result: {spots", r"net:34:49: .*spot.x: 'wide' is not a number"),
        ("result: {spots", "store: {sopt: {x: 1}}, result: {spots", r"store.sopt: no place says of .*'spot'\?"),
    ],
)  # fmt: skip
def test_mistakes_are_named_where_they_stand(find, replace, complaint):
    assert find in NET
    with pytest.raises(NetFileError, match=complaint):
        check_net(parse_net(NET.replace(find, replace)), Types())


def test_a_net_that_fits_is_taken():
    check_net(parse_net(NET), Types())
    assert message_type("p_msgs/msg/Spot").fits(message_type("p_msgs/msg/Spot"))
    assert not list_of(NUMBER).fits(list_of(BOOLEAN))
    assert list_of(ANY).fits(list_of(BOOLEAN))


def test_a_command_of_nobody_has_no_arguments():
    text = (
        "net: n\nplaces: {p: 1, q: }\ntransitions:\n  t: {in: p, out: q, result: {x: '${arguments.y}'}, on_failure: q}"
    )
    for value in ("arguments.y", "answers.t.y"):
        with pytest.raises(NetFileError, match=f"{value[:-2]}.*: the tokens of this transition belong to no command"):
            parse_net(text.replace("arguments.y", value))


SCALARS = re.compile(r"(?<=[:\[,{] )([^\s{}\[\],]+|\"[^\"]*\")(?=[\s},\]])")
JUNK = ['"${"', '"${}"', '"${arguments}"', '"${answers.look}"', '"${1 / 0}"', '"not ${true}"', "null", "true", "-1"]
JUNK += ["1e999", "[a]", "[[1]]", "{a: 1}", '"\\ud800"', "9" * 30, '"${(((((1}"', "x.y", '"${data.spot}"', "''"]


@pytest.mark.parametrize(
    "match", list(SCALARS.finditer(NET)), ids=lambda match: f"{match.start()}-{match.group()[:20]}"
)
def test_whatever_stands_anywhere_is_taken_or_refused_in_a_sentence_that_says_where(match):
    for junk in JUNK:
        text = NET[: match.start()] + junk + NET[match.end() :]
        said = "net:0:0: it is taken"
        try:
            check_net(parse_net(text), Types())
        except NetFileError as error:
            said = error.message
        assert re.fullmatch(r"net:\d+:\d+: \S.*", said), said


def test_what_is_kept_of_answers_outlives_the_death_of_the_process():
    text = NET.replace('data: "x is', 'data: "of ${command.id}: x is').replace(
        "many: 3}}", "many: 3}}\n    on_doubt: told"
    )
    net, calls, ends, gone_on = parse_net(text), [], [], 0

    async def perform(activity, context):
        fields = await context.filled(activity.action.fields)
        calls.append((activity.transition, fields))
        return {"found": True, "spots": SPOTS} if isinstance(activity.action, ServiceAction) else {}

    def life(files):
        process = JournalledProcess("x", [net], files, others={ServiceAction: perform, TopicAction: perform})
        for job in process.exchange.nets["n"].jobs():
            job.on_closed = ends.append
        return process

    whole = {"spots": SPOTS, "by": "pick 1"}
    for steps in range(1, 40):
        files = MemoryFiles()
        files.dies_after(steps)
        calls.clear()
        ends.clear()
        with contextlib.suppress(MemoryFiles.Death):
            process = life(files)
            process.exchange.nets["n"].command(Command(1, "pick", {"width": 0.1}), ends.append)
            process.turn()
        if ends:
            break
        before = len(calls)
        again = life(files.reborn())
        again.turn()
        for end in ends:
            assert [name for name, _ in calls].count("look") == 1, "a service is not called twice"
            assert end.results == (whole if end.success else {})
            assert end.success or end.error.code == "in_doubt"
            gone_on += end.success and len(calls) == before
    assert gone_on, "the process has died between the answer and the result that is made of it"
    assert ends[0].results == whole
    assert steps > 5


class MemoryObjects:
    """Data objects in memory."""

    def __init__(self, **objects: dict[str, object]) -> None:
        self.objects, self.seen, self.asked = objects, {}, []

    async def read(self, name, kind, ways):
        if name not in self.objects:
            raise DataError(f"there is no data object {name}")
        return self.objects[name]

    def latest(self, name, kind, ways):
        if name not in self.seen:
            self.asked.append(name)
            raise ObjectPendingError("it is being read")
        if name not in self.objects:
            raise DataError(f"there is no data object {name}")
        return self.seen[name]

    def stale(self):
        self.seen.clear()

    def answer(self, process):
        """Answers what guards have asked, and wakes them."""
        for name in self.asked:
            self.seen[name] = dict(self.objects.get(name, {}))
        self.asked.clear()
        for executor in process.exchange.nets.values():
            executor.post(GuardsChanged())
        process.pump()

    async def put(self, name, kind, fields, place):
        self.objects[name] = {**fields, "kind": kind, "place": place}

    def run(self, work, done):
        run_at_once(work, done)


def test_data_objects_are_read_and_stored():
    text = NET.replace(
        "result: {spots", 'store: {spot: {x: "${data.spot.x + 1}"}}, result: {was: "${data.spot.x}", spots'
    )
    objects = MemoryObjects(spot={"x": 4.0})
    shared = text.replace("p_msgs/msg/Spot}", "p_msgs/msg/Spot, scope: global}")
    machine = Machine(shared, {"found": True, "spots": SPOTS}, objects=objects)
    machine.process.command("n", "pick", width=0.1)
    assert machine.process.results[0].results["was"] == 4.0
    assert objects.objects["spot"] == {"x": 5.0, "kind": "p_msgs/msg/Spot", "place": "n.asked"}
    objects.objects.clear()
    machine.process.command("n", "pick", width=0.1)
    assert str(machine.process.results[1].error) == "there is no data object spot"
    stored = text.replace("data.spot.x + 1", "command.id + 1").replace('was: "${data.spot.x}", ', "")
    machine = Machine(stored, {"found": True, "spots": SPOTS}, objects=objects)
    numbers = [machine.process.command("n", "pick", width=0.1) for _ in range(2)]
    assert [fields["x"] for fields in objects.objects.values()] == [number + 1 for number in numbers]


@pytest.mark.parametrize("scope", ["command", "global"])
def test_an_object_whose_name_says_arguments_is_the_same_wherever_it_is_named(scope):
    name = "spot/${arguments.group}/${arguments.wide}"
    text = NET.replace("name: spot,", f'name: "{name}", scope: {scope},')
    text = text.replace("least: {", "wide: {type: boolean, default: true}\n      least: {")
    text = text.replace("result: {spots", f'store: {{"{name}": {{x: 5}}}}, result: {{spots')
    text = text.replace("out: looked\n    service", "out: [looked, asked]\n    service")
    text = text.replace("in: done, out: idle", "in: [done, asked], out: idle")
    objects = MemoryObjects()
    machine = Machine(text, {"found": True, "spots": SPOTS}, objects=objects)
    number = machine.process.command("n", "pick", width=0.1)
    stored = "spot/left/true" if scope == "global" else f"node/{number}/spot/left/true"
    assert machine.process.results[0].success
    assert list(objects.objects) == [stored]
    assert machine.begun[0].objects == (stored,)
    assert {machine.contexts[0].object(called) for called in (name, "spot/left/true")} == {stored}


def test_a_guard_over_a_data_object_lets_neither_way_pass_until_the_object_is_known():
    text = NET.replace("len(answers.look.spots) >= arguments.least and answers.look.found", "data.spot.x > 3")
    text = text.replace("p_msgs/msg/Spot}", "p_msgs/msg/Spot, scope: global}")
    check_net(parse_net(text), Types())
    objects = MemoryObjects(spot={"x": 4.0})
    machine = Machine(text, {"spots": SPOTS}, objects=objects)
    machine.process.command("n", "pick", width=0.1)
    assert machine.process.marking("n") == {"looked": 1}
    objects.answer(machine.process)
    assert machine.process.results[0].success
    assert machine.sent[-1][0] == "tell"
    objects.objects["spot"] = {"x": 2.0}
    machine.process.command("n", "pick", width=0.1)
    assert machine.process.marking("n") == {"looked": 1}, "what was known before the action is not known any more"
    objects.answer(machine.process)
    assert [machine.process.recorder.names("n").count(name) for name in ("tell", "skip")] == [1, 1]
    objects.objects.clear()
    machine.process.command("n", "pick", width=0.1)
    objects.answer(machine.process)
    assert machine.process.recorder.troubles[-1].endswith("counts as false: there is no data object spot")


def test_otherwise_lets_pass_where_no_other_guard_does():
    """Also where another guard breaks, and not before it is known what the others say."""
    text = NET.replace(
        "guard: not ${len(answers.look.spots) >= arguments.least and answers.look.found}", "guard: otherwise"
    )
    assert parse_net(text).transitions["skip"].guard.unless == (parse_net(text).transitions["tell"].guard,)
    for answer, told in (
        ({"found": True, "spots": SPOTS}, ["tell"]),
        ({"found": False, "spots": SPOTS}, ["skip"]),
        ({"spots": SPOTS}, ["skip"]),
    ):
        machine = Machine(text, answer)
        machine.process.command("n", "pick", width=0.1)
        assert [name for name in machine.process.recorder.names("n") if name in ("tell", "skip")] == told
    text = text.replace("len(answers.look.spots) >= arguments.least and answers.look.found", "data.spot.x > 3")
    objects = MemoryObjects(spot={"x": 2.0})
    machine = Machine(
        text.replace("p_msgs/msg/Spot}", "p_msgs/msg/Spot, scope: global}"), {"spots": SPOTS}, objects=objects
    )
    machine.process.command("n", "pick", width=0.1)
    assert machine.process.marking("n") == {"looked": 1}
    objects.answer(machine.process)
    assert "skip" in machine.process.recorder.names("n")


def test_a_request_passes_values_on_and_its_results_are_an_answer():
    asking = parse_net(
        "net: a\ncommands: {go: {arguments: {n: {type: integer}}}}\n"
        "places: {p: {tokens: 1, resource: true}, q: , r: }\n"
        "escalate: r\ntransitions:\n"
        '  ask: {symbol: go, in: p, out: q, request: {to: b.twice, arguments: {n: "${arguments.n + 1}"}}, '
        'result: {first: "${answers.ask.m}"}}\n'
        '  note: {in: q, out: p, result: {n: "${answers.ask.m + 1}"}, emit: go_done}\n'
        "  fail: {in: r, out: p, emit: go_failed}"
    )
    served = parse_net(
        "net: b\nplaces: {asked: , done: , failed: }\n"
        "services: {twice: {entry: asked, done: done, failed: failed, arguments: {n: {type: integer, maximum: 9}}}}\n"
        'transitions: {twice: {in: asked, out: done, on_failure: failed, result: {m: "${arguments.n * 2}"}}}'
    )
    process = Process([asking, served])
    process.command("a", "go", n=3)
    assert process.results[0].results == {"first": 8, "n": 9}
    process.command("a", "go", n=9)
    assert "argument n is 10, not a whole number <= 9" in str(process.results[1].error)
