"""Subnets: templates with ports, used as transitions and as scopes; flat, and verified and run so."""

import pytest

from im_core.errors import DataError
from im_pnt.errors import NetFileError
from im_pnt.netfile import load_net, parse_net, yaml_text
from im_pnt_analysis import verify_to_load
from support.process import Process

POWER = """\
templates:
  power:
    arguments:
      group: {type: string, choices: [left, right]}
      again: {type: boolean, default: "${failure.code == 'anew'}"}
    ports: {in: [wanted, moved, missed], out: [powered, done], on_failure: failed}
    places: {on: }
    transitions:
      up: {in: wanted, out: [powered, on], action: up, says: "power ${arguments.group}", on_failure: [missed, on]}
      down: {in: [moved, on], out: done, action: down, on_failure: failed}
      again: {in: [missed, on], guard: "${arguments.again}", out: wanted}
      give_up: {in: [missed, on], guard: "not ${arguments.again}", out: failed, action: down, on_failure: failed}
"""
NET = f"""\
net: n
{POWER}
places: {{arm: 1, asked: , done: , failed: }}
transitions:
  begin: {{symbol: go, in: arm, out: asked}}
  go: {{with: {{power: {{group: left}}}}, in: asked, out: done, action: go, on_failure: failed}}
  end: {{in: done, out: arm, emit: go_done}}
  end_failed: {{in: failed, out: arm, emit: go_failed}}
"""
COUNTER = """\
net: n
templates:
  twice:
    arguments: {item: {type: integer, minimum: 0}, more: {type: integers}, label: {type: string}}
    results: {count: "${data.seen.data + arguments.item}", first: "${answers.ask.value}"}
    ports: {in: begun, out: ended, on_failure: missed}
    places: {asked: , kept: {data_object: {name: seen, type: std_msgs/msg/Int64}}}
    transitions:
      ask:
        in: begun
        out: asked
        request:
          to: other.ask
          arguments: {at: "${arguments.item + 1}", all: "${arguments.more}", of: "$(seen)",
                      which: "part ${arguments.label}", first: "${arguments.more[0]}"}
        on_failure: missed
      keep: {in: asked, out: kept, store: {seen: {data: "${arguments.item}"}}, on_failure: missed}
      end: {in: kept, guard: "${data.seen.data > 0 or answers.ask.value == arguments.label}", out: ended}
      end_too: {in: kept, guard: otherwise, out: ended}
  outer:
    arguments: {item: {type: integer}}
    ports: {in: start, out: stop, on_failure: missed}
    transitions:
      inner:
        {use: twice, in: start, out: stop, on_failure: missed,
         arguments: {item: "${arguments.item * 2}", more: [1, 2], label: x}}
commands: {go: {arguments: {size: {type: integer}}}}
places: {arm: 1, asked: , told: , halfway: , failed: }
transitions:
  begin: {symbol: go, in: arm, out: asked}
  first: {use: outer, in: asked, out: halfway, on_failure: failed, arguments: {item: "${arguments.size}"}}
  second:
    {use: twice, in: halfway, out: told, on_failure: failed,
     arguments: {item: 3, more: [4], label: "${command.symbol}"}}
  tell: {in: told, out: arm, result: {count: "${answers.second.count}"}, emit: go_done, on_failure: failed}
  end_failed: {in: failed, out: arm, emit: go_failed}
"""


def run(functions):
    process = Process([parse_net(NET)], functions)
    process.command("n", "go")
    return process, process.recorder.names("n")


def failing(code=""):
    def act(_ctx):
        raise DataError("no", code=code)

    return act


def test_a_scope_is_entered_before_its_transition_and_left_after_it():
    process, names = run(dict.fromkeys(("up", "go", "down"), lambda _: None))
    assert [name for name in names if "+" not in name] == ["begin", "go.power.up", "go", "go.power.down", "end"]
    assert process.marking("n") == {"arm": 1}


@pytest.mark.parametrize("fails", ["up", "go"])
def test_a_scope_is_left_after_a_failure_inside_of_it_too(fails):
    functions = {name: failing() if name == fails else lambda _: None for name in ("up", "go", "down")}
    process, names = run(functions)
    assert names[-2:] == ["go.power.give_up", "end_failed"]
    assert process.marking("n") == {"arm": 1}
    assert not process.results[0].success


def test_a_scope_may_begin_once_more():
    codes = iter(["anew"])

    def go(_ctx):
        for code in codes:
            raise DataError("no", code=code)

    process, names = run({"up": lambda _: None, "go": go, "down": lambda _: None})
    assert [name for name in names if "+" not in name][2:6] == ["go!", "go.power.again", "go.power.up", "go"]
    assert process.results[0].success


def test_a_subnet_is_verified_with_the_rest_and_a_net_is_read_as_it_is_shown():
    net = parse_net(NET)
    verify_to_load([net]).require_ok()
    assert "go.power.on" in net.places
    assert yaml_text(parse_net(yaml_text(net))) == yaml_text(net)


@pytest.mark.parametrize(
    ("kept", "forgotten"),
    [
        ("down: {in: [moved, on], out: done, action: down", "down: {in: moved, out: done, action: down"),
        ("give_up: {in: [missed, on]", "give_up: {in: missed"),
        ("again: {in: [missed, on]", "again: {in: missed"),
    ],
)
def test_a_way_out_that_does_not_give_back_what_the_scope_holds_is_refused(kept, forgotten):
    assert kept in NET
    report = verify_to_load([parse_net(NET.replace(kept, forgotten))])
    assert not report.ok
    assert "go.power.on" in str(report.refusals)


def test_names_arguments_results_and_data_objects_are_of_the_use():
    net = parse_net(COUNTER)
    ask = net.transitions["first.inner.ask"]
    assert ask.inputs == {"asked": 1}
    assert ask.action.fields == {
        "at": "${(arguments.size * 2) + 1}",
        "all": [1, 2],
        "of": "first.inner.seen",
        "which": "part x",
        "first": "${[1, 2][0]}",
    }
    assert net.transitions["first.inner.keep"].store == {"first.inner.seen": {"data": "${arguments.size * 2}"}}
    assert net.places["second.kept"].data_object == "second.seen"
    guard = str(net.transitions["second.end"].guard)
    assert guard == "${(data.'second.seen'.data > 0) or (answers.'second.ask'.value == command.symbol)}"
    assert net.transitions["tell"].result == {"count": "${data.'second.seen'.data + 3}"}
    assert net.transitions["first.inner.ask"].line == 9
    assert yaml_text(parse_net(yaml_text(net))) == yaml_text(net)


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("use: outer", "use: otter", r"net:31:16: use: there is no template 'otter' \(did you mean 'outer'"),
        (
            "{use: outer, in: asked",
            "{use: outer, in: [asked, arm]",
            r"31:\d+: in: subnet outer has 1 ports here \(start\), not 2",
        ),
        (
            "use: outer, in: asked",
            "use: outer, in: aksed",
            r"net:31:27: there is no place 'aksed' \(did you mean 'asked'",
        ),
        ("first: {use: outer", "first: {delay: 1.0, use: outer", r"net:31:11: 'delay' is not a known key"),
        ('{item: "${arguments.size}"}', "{itme: 1}", r"subnet outer has no argument 'itme' \(did you mean 'item'"),
        ('{item: "${arguments.size}"}', "{}", "subnet outer needs its argument 'item'"),
        ("{item: 3,", "{item: -3,", r"net:34:24: argument item is -3, not a whole number >= 0"),
        ("{item: 3,", "{item: three,", "argument item is 'three', not a whole number"),
        ("{item: 3,", "{item: '${arguments.sise}',", r"arguments.sise: go, served here, has no such argument.*'size'"),
        (
            "arguments.item + 1",
            "arguments.itm + 1",
            r"net:14:27: arguments.itm: the subnet has no such argument.*'item'.*used in net:24:7",
        ),
        (
            "answers.ask.value ==",
            "answers.begin.value ==",
            r"answers.begin: there is no transition 'begin' in the subnet",
        ),
        (
            "${data.seen.data >",
            "${data.sen.data >",
            r"data.sen: there is no data object 'sen' in the subnet \(did you mean 'seen'",
        ),
        ("keep: {in: asked", "keep: {in: told", r"net:17:18: there is no place 'told'.*subnet twice, used in net:24:7"),
        (
            "keep: {in: asked",
            "keep: {in: [asked, ended]",
            "'ended' is a port that the subnet gives tokens to, and takes none",
        ),
        (
            "places: {asked: , kept",
            "places: {asked: , begun: , kept",
            "'begun' is a port, which the place at each use is",
        ),
        ("use: twice, in: start", "use: outer, in: start", "uses go round: outer -> outer"),
        ("answers.second.count", "answers.second.cont", "answers.second has no result 'cont'.*'count'"),
        (
            "    ports: {in: start, out: stop, on_failure: missed}\n",
            "",
            "net:21:5: templates.outer.arguments: is for templates with 'ports'",
        ),
        ("label: x}", 'label: "it\'s"}', None),
    ],
)
def test_mistakes_point_into_the_subnet_and_at_its_use(find, replace, complaint):
    assert find in COUNTER
    text = COUNTER.replace(find, replace, 1)
    if complaint is None:
        with pytest.raises(NetFileError, match="which cannot be part of an expression"):
            parse_net(text)
        return
    with pytest.raises(NetFileError, match=complaint):
        parse_net(text)


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("with: {power: {group: left}}", "with: powr", r"net:18:14: 'powr' is no scope: .*\(did you mean 'power'"),
        ("with: {power: {group: left}}", "with: power", "subnet power needs its argument 'group'"),
        ("{group: left}", "{group: lift}", "argument group is 'lift', not one of 'left', 'right'"),
        ("in: asked, out: done", "in: [asked, arm], out: done", "needs one place in each of in, out, on_failure"),
        ("action: go, on", "action: go, guard: late, on", "'guard' does not go together with a scope"),
        ("out: [powered, done]", "out: done", "'power' is no scope: a scope is a template with three ports"),
    ],
)
def test_mistakes_of_scopes_are_named(find, replace, complaint):
    assert find in NET
    with pytest.raises(NetFileError, match=complaint):
        parse_net(NET.replace(find, replace, 1))


@pytest.mark.parametrize(
    ("net", "complaint"),
    [
        (
            "places: {p: 1, t.active: }, transitions: {t: {in: p, out: p}}",
            "'t.active' is the name of a part that is made",
        ),
        ("places: {p: 1}, transitions: {t: {in: p, out: p}, t.start: {in: p}}", "'t.start' is .* made of 't'"),
        (
            "places: {p: 1, d: , f: }, services: {ask: {entry: p, done: d, failed: f}}, "
            "transitions: {accept.ask: {in: p, out: d}}",
            "'accept.ask' is .* made of 'ask'",
        ),
        ("places: {p.: 1}, transitions: {t: {in: p}}", "'p.' is not a name"),
    ],
)
def test_names_with_dots_are_not_those_that_the_expansion_makes(net, complaint):
    with pytest.raises(NetFileError, match=complaint):
        parse_net(f"{{net: n, {net}}}")


def test_a_use_without_any_template_is_named():
    with pytest.raises(NetFileError, match=r"no template 'a'; there is none in the net"):
        parse_net("{net: n, places: {p: 1}, transitions: {t: {use: a, in: p}}}")


def test_a_template_with_ports_is_no_copy():
    with pytest.raises(NetFileError, match=r"use.template: template power has ports: a transition uses it"):
        parse_net(f"{NET}use: {{template: power}}\n")


def test_a_subnet_of_an_included_file_is_named_with_that_file(tmp_path):
    (tmp_path / "power.yaml").write_text(POWER.replace("out: wanted}", "out: wanetd}"))
    (tmp_path / "n.yaml").write_text(NET.replace(POWER, "include: power.yaml\n"))
    with pytest.raises(NetFileError, match=r"power.yaml:11:\d+: .*'wanetd'.*used in .*n.yaml:7:15\)"):
        load_net(tmp_path / "n.yaml")
