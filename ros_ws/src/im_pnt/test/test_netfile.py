import contextlib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.errors import NetFileError
from im_pnt.net import FunctionAction, GoalAction, Guard, RemotePlace, RequestAction, ServiceAction
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
"""


def test_every_key_is_read():
    net = parse_net(GOOD, "good.yaml")
    assert net.places["b"].capacity == 2
    assert net.places["b"].on_invalid == ("c",)
    assert net.places["b"].remote
    assert net.initial_marking() == {"a": 1}
    t1, t2, t3, t4, t5 = net.transitions.values()
    assert (t1.inputs, t1.outputs, t1.inhibitors) == ({"a": 2}, {"b": 2}, {"c": 1})
    assert (t1.guard, t1.symbol, t1.emit, t1.priority, t1.line) == (Guard("g", True), "go", ("x", "y"), -2, 11)
    assert t2.remote_outputs == {RemotePlace("other", "p"): 1}
    assert (t2.action, t2.timeout) == (FunctionAction("f"), 2.0)
    assert t3.action == ServiceAction("/x/y", "p_msgs/srv/Do", {"group": "left"})
    assert t4.action == GoalAction("/m", "p_msgs/action/Move", {}, "f", "h", "mcs")
    assert t5.action == RequestAction("other", "serve", {"n": 3}, "f")
    assert net.partners() == {"other"}
    assert net.functions() == {"f", "h"}


@pytest.mark.parametrize(
    ("find", "replace", "complaint"),
    [
        ("inhibitors: {c: 1}", "inhibitor: {c: 1}", r"good.yaml:11: transitions.t1: 'inhibitor' .*did you mean 'inhib"),
        ("out: {b: 2}", "out: {bb: 2}", r"good.yaml:11: .*there is no place 'bb' \(did you mean 'b'\?\)"),
        ("capacity: 2", "capacity: 0", r"good.yaml:4: places.b.capacity: 0 is not >= 1"),
        ("a: 1", "a: -1", r"good.yaml:3: places.a: -1 is not >= 0"),
        ("a: 1", "a: true", r"good.yaml:3: places.a: 'true' is not a whole number"),
        ("a: 1", "a: {tokens: 3, capacity: 2}", "3 tokens are more than the capacity of 2"),
        ("  c:\n", "  c:\n  c: 1\n", r"good.yaml:6: places: 'c' is there twice; the first is in line 5"),
        ("  c:\n", "  SI:\n", "belongs to the coordination structure"),
        ("failed: c", "failed: a", "must be three different places"),
        ("data_object: path, ", "", "needs a data_object"),
        ("escalate: c", "escalate: d", r"good.yaml:8: escalate: there is no place 'd'"),
        ("escalate: c\n", "", r"good.yaml:11: transitions.t2: function f can fail: say where .*'on_failure'"),
        ("symbol: go", "on_failure: c", r"needs an action that can fail"),
        ("action: f", "action: f, request: x.y", "has action and request; one action is allowed"),
        ("p_msgs/srv/Do", "p_msgs/action/Do", "'p_msgs/action/Do' is not of the form package/srv/Type"),
        ("to: other.serve", "to: serve", "'serve' is not of the form net.service"),
        ("timeout: 2", "timeout: 0", "'0' is not a number > 0"),
        ("other.p]", "n.p]", "'n.p' is a place of this very net; write 'p'"),
        ("in: [a, a]", "in: [other.a]", "only 'out' may name one"),
        ("in: [a, a]", "in: [c]", "both enables and disables"),
        ("t2: {in: a, ", "t2: {", "neither input places nor a symbol"),
        ("net: n", "net: 9n", "'9n' is not a name"),
        ("net: n\n", "", "good.yaml:1: 'net' is missing"),
        ("guard: not g", "guard: g and h", "'g and h' is not a name"),
        ("{in: [a, a]", "{in: [a, [a]]", "is not a text"),
        ("priority: -2}", "priority: -2", "not YAML"),
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


LINES = GOOD.splitlines()


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_damaged_file_is_read_or_refused_and_never_breaks_anything_else(data):
    text = GOOD
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(text)))
        cut = data.draw(st.integers(0, 12))
        text = text[:at] + data.draw(st.text("abc{}[]:,*&!|>'\" \n\t-#%1é\x00", max_size=6)) + text[at + cut :]
    with contextlib.suppress(NetFileError):
        parse_net(text, "x.yaml")
