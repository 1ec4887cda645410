import contextlib
from dataclasses import replace
from xml.etree import ElementTree

from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net, yaml_text
from im_pnt.pnml import pnml_text

NET = """\
net: cell
description: every kind of thing
places:
  a: 1
  b: {tokens: 0, capacity: 2, data_object: path, on_invalid: [c], remote: true}
  c:
services: {s: {entry: b, done: a, failed: c}}
escalate: c
rest: [a]
transitions:
  t1: {in: [a, a], out: {b: 2}, inhibitors: {c: 1}, guard: not g, symbol: go, emit: [x, y], priority: -2}
  t2: {in: a, out: [b, other.p], action: f, timeout: 2, on_doubt: c, success: 0.5}
  t3: {in: a, service: {name: /x, type: p_msgs/srv/Do, request: {group: [1, {a: ~}]}}}
  t4: {in: a, goal: {name: /m, type: p_msgs/action/Move, build: f, task: mcs}, on_failure: b}
  t5: {in: a, request: {to: other.serve, arguments: {n: 3}}, delay: {gamma: {shape: 2, scale: 1}}}
  t6: {in: a, topic: {name: /w, type: p_msgs/msg/W, message: {}}, strategy: {decay: 0.9}, weight: 3}
"""
TEMPLATE = """\
net: ring
templates:
  cell: {parameters: [i, n], places: {p$(i): 1}, rest: [p$(i)], transitions: {t$(i): {in: p$(i), out: p$(i+1 mod n)}}}
use: [{template: cell, for: {i: 0..4}, with: {n: 5}}]
include: []
"""
YAML = (NET, TEMPLATE)
PIECES = [
    "{",
    "}",
    "[",
    "]",
    ": ",
    ", ",
    "\n",
    "\n  ",
    "- ",
    "&x ",
    "*x",
    "<<: ",
    "!!int ",
    "|",
    "'",
    '"',
    "#",
    "\t",
    "\x00",
    "$(",
    ")",
    "$(i*i*i)",
    "0..99999",
    "..",
    "-1",
    "1e999",
    ".nan",
    "99999999999999999999999",
    "~",
    "on",
    "é",
    "\ud800",
    "\u2028",
    "net",
    "places",
    "SI",
    "t1",
    "not ",
    "a.b.c",
    "%",
    "---\n",
    "? ",
    "0x1",
    "\\",
]


def read(tmp, suffix, content):
    """A net or an error of ours, nothing else."""
    file = tmp / f"fuzz{suffix}"
    file.write_bytes(content)
    with contextlib.suppress(ImError):
        assert isinstance(load_net(file), Net)


damages = st.tuples(st.floats(0, 1), st.integers(0, 25), st.sampled_from(PIECES))


@settings(max_examples=500, deadline=None)
@given(st.sampled_from(YAML), st.lists(damages, max_size=4))
def test_damaged_yaml_is_a_net_or_an_error(text, done):
    for where, cut, piece in done:
        at = int(where * len(text))
        text = text[:at] + piece + text[at + cut :]
    with contextlib.suppress(ImError):
        assert isinstance(parse_net(text, "x"), Net)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200), st.sampled_from([".yaml", ".pnml", ".xml"]), st.booleans())
def test_random_bytes_are_an_error(tmp_path_factory, content, suffix, inside):
    sound = pnml_text(parse_net(NET)).encode() if suffix != ".yaml" else NET.encode()
    middle = len(sound) // 2
    content = sound[:middle] + content + sound[middle:] if inside else content
    read(tmp_path_factory.getbasetemp(), suffix, content)


OURS = ElementTree.fromstring(pnml_text(parse_net(NET)))
STRINGS = [
    "",
    " ",
    "t1",
    "a",
    "b",
    "other.p",
    "-1",
    "0",
    "3",
    "1e3",
    "99999999999",
    '"g"',
    "[]",
    "{}",
    "[[[[",
    "null",
    "NaN",
    '{"a": 1, "a": 2}',
    '{"name": 3}',
    "1",
    "inhibitor",
    "test",
    "reset",
    "Default,2",
    "[0,inf)",
    "[1,2]",
    "\u00e9",
    "http://www.pnml.org/version-2009/grammar/symmetricnet",
    "im",
    "other",
    "SI",
]
TAGS = [
    "place",
    "transition",
    "arc",
    "page",
    "net",
    "referencePlace",
    "referenceTransition",
    "name",
    "text",
    "value",
    "type",
    "initialMarking",
    "inscription",
    "toolspecific",
    "graphics",
    "capacity",
    "hlinscription",
    "{urn:im:pnt:net:1}guard",
    "{urn:im:pnt:net:1}delay",
    "{urn:im:pnt:net:1}services",
    "{urn:x}y",
    "pnml",
]
KEYS = ["id", "source", "target", "ref", "type", "tool", "version", "weight", "inscription", "initialMarking", "value"]


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_pnml_is_a_net_or_an_error(tmp_path_factory, data):
    root = ElementTree.fromstring(ElementTree.tostring(OURS))
    for _ in range(data.draw(st.integers(1, 4))):
        elements = list(root.iter())
        element, other = data.draw(st.sampled_from(elements)), data.draw(st.sampled_from(elements))
        match data.draw(st.sampled_from(["attribute", "attribute", "text", "tag", "remove", "copy"])):
            case "attribute":
                element.set(data.draw(st.sampled_from(KEYS)), data.draw(st.sampled_from(STRINGS)))
            case "text":
                element.text = data.draw(st.sampled_from(STRINGS))
            case "tag":
                prefix = root.tag[: -len("pnml")] if root.tag.endswith("pnml") else ""
                tag = data.draw(st.sampled_from(TAGS))
                element.tag = tag if tag.startswith("{") else prefix + tag
            case "remove" if other in element:
                element.remove(other)
            case "copy" if element not in list(other.iter()):
                element.append(ElementTree.fromstring(ElementTree.tostring(other)))
            case _:
                element.clear()
    read(tmp_path_factory.getbasetemp(), ".pnml", ElementTree.tostring(root))


def test_the_sound_files_are_nets(tmp_path):
    (tmp_path / "ring.yaml").write_text(TEMPLATE)
    net = parse_net(NET)
    assert len(load_net(tmp_path / "ring.yaml").places) == 5
    assert yaml_text(replace(net, source="")) == yaml_text(net)
