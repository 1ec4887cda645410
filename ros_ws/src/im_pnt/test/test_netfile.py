import os

import pytest

from im_core.clock import cpu
from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.model.action import FunctionAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.delay import Delay
from im_pnt.model.net import Guard, RemotePlace, Strategy
from im_pnt.netfile import load_net, parse_net

GOOD = """\
net: n
places:
  a: 1
  b: {tokens: 0, capacity: 2, data_object: path, on_invalid: [c], remote: true}
  c:
services:
  s: {entry: b, done: a, failed: c}
escalate: c
rest: [a]
transitions:
  t1: {in: [a, a], out: {b: 2}, inhibitors: {c: 1}, guard: not g, symbol: go, emit: [x, y], priority: -2}
  t2: {in: a, out: [b, other.p], action: f, timeout: 2}
  t3: {in: a, service: {name: /x/y, type: p_msgs/srv/Do, request: {group: left}}}
  t4: {in: a, goal: {name: /m, type: p_msgs/action/Move, build: f, handle: h, task: mcs}, on_failure: b}
  t5: {in: a, request: {to: other.serve, arguments: {n: 3}, build: f}}
  t6: {in: a, topic: {name: /say, type: p_msgs/msg/Word, message: {w: on}, build: f}, on_doubt: [b, c], success: 0.5}
  t7: {in: a, delay: {exponential: {mean: 0.5}}, weight: 39}
  t8: {in: a, action: f, delay: 2.5, strategy: {successes: 3, decay: 0.9}}
"""


def test_every_key_is_read():
    net = parse_net(GOOD, "good.yaml")
    assert net.places["b"].capacity == 2
    assert net.places["b"].on_invalid == ("c",)
    assert net.places["b"].remote
    assert net.initial_marking() == {"a": 1}
    t1, t2, t3, t4, t5, t6, t7, t8 = net.transitions.values()
    assert (t1.inputs, t1.outputs, t1.inhibitors) == ({"a": 2}, {"b": 2}, {"c": 1})
    assert (t1.guard, t1.symbol, t1.emit, t1.priority, t1.line) == (Guard("g", True), "go", ("x", "y"), -2, 11)
    assert t2.remote_outputs == {RemotePlace("other", "p"): 1}
    assert (t2.action, t2.timeout) == (FunctionAction("f"), 2.0)
    assert t3.action == ServiceAction("/x/y", "p_msgs/srv/Do", {"group": "left"})
    assert t4.action == GoalAction("/m", "p_msgs/action/Move", {}, "f", "h", "mcs")
    assert t5.action == RequestAction("other", "serve", {"n": 3}, "f")
    assert t6.action == TopicAction("/say", "p_msgs/msg/Word", {"w": "on"}, "f")
    assert (t6.on_doubt, t6.success) == ({"b": 1, "c": 1}, 0.5)
    assert (t7.delay, t7.weight) == (Delay("exponential", (2.0,)), 39.0)
    assert (t8.delay, t8.strategy) == (Delay("constant", (2.5,)), Strategy(3.0, 1.0, 0.9))
    assert net.partners() == {"other"}
    assert net.functions() == {"f", "h"}


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("inhibitors: {c: 1}", "inhibitor: {c: 1}", r"good.yaml:11:\d+: transitions.t1: 'inhibitor' .*mean 'inhib"),
        ("out: {b: 2}", "out: {bb: 2}", r"good.yaml:11:\d+: .*there is no place 'bb' \(did you mean 'b'\?\)"),
        ("capacity: 2", "capacity: 0", r"good.yaml:4:\d+: places.b.capacity: 0 is not >= 1"),
        ("a: 1", "a: -1", r"good.yaml:3:\d+: places.a: -1 is not >= 0"),
        ("a: 1", "a: true", r"good.yaml:3:\d+: places.a: 'true' is not a whole number"),
        ("a: 1", "a: {tokens: 3, capacity: 2}", "3 tokens are more than the capacity of 2"),
        ("  c:\n", "  c:\n  c: 1\n", r"good.yaml:6:\d+: places: 'c' is there twice; the first is in line 5"),
        ("  c:\n", "  SI:\n", "belongs to the coordination structure"),
        ("failed: c", "failed: a", "must be three different places"),
        ("data_object: path, ", "", "needs a data_object"),
        (
            "services:\n  s: {entry: b, done: a, failed: c}",
            "at_once: 2",
            r"good.yaml:6:\d+: at_once: is for requests to services, and the net offers none",
        ),
        (
            "data_object: path",
            'data_object: "${arguments.a}"',
            "data_object: there is no 'arguments.a' that a name could say",
        ),
        ("escalate: c", "escalate: c\nat_once: 0", "at_once: 0 is not >= 1"),
        ("escalate: c", "escalate: d", r"good.yaml:8:\d+: escalate: there is no place 'd'"),
        ("escalate: c\n", "", r"good.yaml:11:\d+: transitions.t2: function f can fail: say where .*'on_failure'"),
        ("symbol: go", "on_failure: c", r"needs an action that can fail"),
        ("action: f", "action: f, request: x.y", "has action and request; one action is allowed"),
        ("p_msgs/srv/Do", "p_msgs/action/Do", "'p_msgs/action/Do' is not of the form package/srv/Type"),
        ("name: /x/y", "name: /x y", r"good.yaml:13:\d+: .*'/x y' is no name of ROS"),
        ("name: /m", "name: /m/", "'/m/' is no name of ROS"),
        ("name: /say", "name: /1/say", "'/1/say' is no name of ROS"),
        ("name: /say", "name: /a//say", "'/a//say' is no name of ROS"),
        ("symbol: go", "arguments: {n: 1}", r"transitions.t\d.arguments: is for 'use'; those of a request stand in it"),
        ("to: other.serve", "to: serve", "'serve' is not of the form net.service"),
        ("timeout: 2", "timeout: 0", "'0' is not a number > 0"),
        ("other.p]", "n.p]", "'n.p' is a place of this very net; write 'p'"),
        ("in: [a, a]", "in: [other.a]", "only 'out' may name one"),
        ("in: [a, a]", "in: [c]", "both enables and disables"),
        ("t2: {in: a, ", "t2: {", "neither input places nor a symbol"),
        ("net: n", "net: 9n", "'9n' is not a name"),
        ("net: n\n", "", "good.yaml:1:1: 'net' is missing"),
        ("guard: not g", "guard: g and h", "'g and h' is not a name or"),
        ("{in: [a, a]", "{in: [a, [a]]", "is not a text"),
        ("priority: -2}", "priority: -2", "not YAML"),
        ("out: [b, other.p]", "out: [b, cc]", r"good.yaml:12:24: transitions.t2.out\[1\]: there is no place 'cc'"),
        ("p_msgs/msg/Word", "p_msgs/srv/Word", "'p_msgs/srv/Word' is not of the form package/msg/Type"),
        ("success: 0.5", "success: 1.5", r"transitions.t6.success: '1.5' is not a number >= 0 and <= 1"),
        ("weight: 39", "weight: 0", "'0' is not a number > 0"),
        ("weight: 39", "success: 0.5", "success: needs an action that can fail"),
        ("mean: 0.5", "mean: 0", "mean 0 is not > 0"),
        ("mean: 0.5", "mean: 0.5, rate: 2", "needs either rate .1/s. or mean .s."),
        ("exponential: {mean", "exponentail: {mean", r"no distribution 'exponentail' \(did you mean 'exponential'"),
        ("{exponential: {mean: 0.5}}", "{uniform: {low: 2, high: 1}}", "high 1.0 is less than low 2.0"),
        ("{exponential: {mean: 0.5}}", "{gamma: {shape: 2}}", "delay.gamma: 'scale' is missing"),
        ("{exponential: {mean: 0.5}}", "{lognormal: {mu: 9000, sigma: 1}}", "has no finite mean"),
        ("delay: 2.5", "delay: -1", "'-1' is not a number >= 0"),
        ("delay: 2.5", "delay: .nan", "'.nan' is not a finite number"),
        ("decay: 0.9", "decay: 0", "'0' is not a number > 0 and <= 1"),
        ("decay: 0.9", "decai: 0.9", r"'decai' is not a known key \(did you mean 'decay'"),
        ("n: 3}", "n: 3, n: 4}", "arguments: 'n' is there twice; the first is in line 15"),
        ("n: 3}", "n: 1e999}", "'1e999' is not a finite number"),
        ("a: 1", "a: 99999999999", "99999999999 is not <= 2147483647"),
        ("a: 1", "a: 0x10", "'0x10' is not a whole number"),
        ("remote: true", "remote: yes", "'yes' is neither true nor false"),
        ("a: 1", "a: !!int 1", "tag 'tag:yaml.org,2002:int' is not allowed"),
        ("symbol: go", 'symbol: "go\\x07"', "control character U[+]0007"),
    ],
)
def test_each_mistake_is_named_with_its_line(find, replace, complaint):
    assert find in GOOD
    with pytest.raises(ImError, match=complaint):
        parse_net(GOOD.replace(find, replace, 1), "good.yaml")


@pytest.mark.parametrize("text", ["", "- a", "a: *b", "a: &a [*a]", "{net: n, places: {}, transitions: {}}", "\t"])
def test_what_is_no_net_is_refused(text):
    with pytest.raises(ImError, match=r"^x.yaml:1"):
        parse_net(text, "x.yaml")


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ImError, match=r"no\.yaml:1: cannot be read: No such file"):
        load_net(tmp_path / "no.yaml")


DEEP = "net: n\nplaces: " + "[" * 5000
BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (DEEP, r"^x:2:\d+: values nest deeper than 40"),
        (BOMB, r"^x:\d+:\d+: more than 500000 values"),
        ("a: &a {b: *a}", r"^x:1:11: alias '\*a' contains itself"),
        ("a: *b", r"^x:1:4: there is no anchor '&b'"),
        ("net: n\n---\nnet: m", r"^x:2:1: a second document begins"),
        ("places:\n\ta: 1", r"^x:2:1: not YAML"),
        ("net: \ud800", r"^x:1:1: not YAML"),
        ("net: n\x00", r"^x:1:1: not YAML"),
        ("? [a]\n: b", r"^x:1:3: a list is not a text"),
        (f"net: {'p' * 5000}\nplaces: {{}}\ntransitions: {{}}", "^x:1:6: net: 'p{60}...' is not a name .*at most 200"),
        ("net: n\nplaces: {a: 1}\ntransitions: {t: {in: a, priority: " + "9" * 5000 + "}}", "at most 20 digits"),
        ("include: x.yaml", "'x.yaml' cannot be included: this net is a text without a file"),
    ],
)
def test_hostile_text_is_refused_where_it_stands(text, complaint):
    with pytest.raises(NetFileError, match=complaint):
        parse_net(text, "x")


MANY = 20_000
MANY_RANGES = ", ".join(f"k{i}: 0..9999" for i in range(MANY))
MANY_NAMES = ", ".join(f"k{i}" for i in range(MANY))
MANY_MISTAKES = "".join(f"  p{i}: x\n" for i in range(MANY))


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (f"net: n\nplaces:\n{MANY_MISTAKES}transitions: {{}}\n", "^x:3:7: places.p0: 'x' is not a whole number"),
        (f"net: n\nplaces: {{a: 1}}\n{MANY_MISTAKES.replace('  p', 'p')}", "^x:3:1: 'p0' is not a known key"),
        (f"net: n\ntemplates: {{t: }}\nuse: {{template: t, for: {{{MANY_RANGES}}}}}\n", "copies; 10000 are allowed"),
        (f"net: n\ntemplates: {{t: {{parameters: [{MANY_NAMES}]}}}}\nuse: {{template: t}}\n", "parameter 'k0'$"),
        (f"net: n\nplaces: {{a: 1}}\ntransitions: {{t: {{in: [{MANY_NAMES}]}}}}\n", "there is no place 'k0'"),
    ],
)
def test_many_mistakes_take_no_longer_than_one(text, complaint):
    began = cpu()
    with pytest.raises(NetFileError, match=complaint):
        parse_net(text, "x")
    assert cpu() - began < 10.0


def test_words_are_read_as_yaml_1_2_reads_them():
    net = parse_net(
        "net: n\nplaces: {on: 1, yes: , y: 2}\n"
        "transitions: {no: {in: [on], out: y, topic: {name: n, type: p/msg/M, message: {a: off, b: 012, c: 1_0, "
        "d: true, e: 1.5e3, f: ~, g: '1'}}, on_failure: yes}}\n"
    )
    assert list(net.places) == ["on", "yes", "y"]
    action = net.transitions["no"].action
    assert isinstance(action, TopicAction)
    assert action.fields == {"a": "off", "b": "012", "c": "1_0", "d": True, "e": 1500.0, "f": None, "g": "1"}


def test_paths_that_lead_to_no_file_are_named(tmp_path):
    loop = tmp_path / "loop.yaml"
    loop.symlink_to(loop)
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    large = tmp_path / "large.yaml"
    with large.open("wb") as file:
        file.truncate(100 * 2**20)
    binary = tmp_path / "binary.yaml"
    binary.write_bytes(b"net: n\nplaces: \xff")
    large_xml = tmp_path / "large.pnml"
    os.link(large, large_xml)
    for path, complaint in [
        (tmp_path, "Is a directory|not a regular file"),
        (loop, "Too many levels of symbolic links"),
        (pipe, "not a regular file"),
        (large, "is larger than 4 MiB"),
        (large_xml, "is larger than 32 MiB"),
        (binary, r"binary.yaml:2:9: is not UTF-8 text"),
        (tmp_path / "a\0b", "cannot be read: embedded null byte"),
    ]:
        with pytest.raises(NetFileError, match=complaint):
            load_net(path)


@pytest.mark.parametrize(
    ("transition", "complaint"),
    [
        ("{in: a, out: a, delay: 1, servers: 0}", r"^x:3:\d+: transitions.t.servers: 0 is not >= 1"),
        ("{in: a, out: a, delay: 1, servers: many}", "'many' is neither a whole number nor inf"),
        ("{in: a, out: a, servers: 2}", r"servers: needs something that takes time \(action, .*, delay\)"),
        ("{in: a, out: a, delay: 1, servers: 2, guard: g}", "with a delay, and 'guard' lets not all wait"),
        ("{in: a, out: a, delay: 1, servers: inf, symbol: s}", "with a delay, and 'symbol' lets not all wait"),
        ("{symbol: s, in: a, out: a}, u: {in: [b, b], delay: 1, servers: 2}", "takes several that may belong to comm"),
        ("{in: a, out: a, action: f, on_failure: a, tries: 2, servers: 1}", "of one try, and 'tries' makes several"),
    ],
)
def test_servers_that_nobody_could_count_are_refused(transition, complaint):
    with pytest.raises(NetFileError, match=complaint):
        parse_net(f"net: n\nplaces: {{a: , b: }}\ntransitions: {{t: {transition}}}", "x")
