"""Nets as other tools write them: read with their meaning, or refused by name.

The files of ``foreign`` are written by hand, after the writers in the sources of each tool.
"""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_pnt.errors import NetFileError
from im_pnt.netfile import load_net, parse_net, yaml_text
from im_pnt.pnml import pnml_text

FOREIGN = Path(__file__).parent / "foreign"

MEANINGS = {
    "pm4py_accepting.pnml": """
net: net1
places: {source: 2, mid: {title: drilled}, sink: }
rest: sink
transitions:
  t3f2a: {title: drill a hole, in: source, inhibitors: sink, out: mid}
  skip: {in: {mid: 2}, out: sink}
""",
    "pm4py_stochastic.pnml": """
net: net1
places: {p: 1}
transitions:
  good: {in: p, out: p, weight: 0.75, priority: 1}
  bad: {in: p, out: p, weight: 0.25}
""",
    "prom_accepting.pnml": """
net: net1
description: orders
places: {n1: {title: begun, tokens: 1}, n2: {title: paid}, n3: {title: refused}}
rest: [n2, n3]
transitions:
  n4: {title: pay, in: n1, out: {n2: 2}}
  n5: {title: refuse, in: n1, out: n3}
""",
    "prom_no_final.pnml": """
net: net1
description: orders
places: {n1: {title: begun, tokens: 1}}
transitions:
  n2: {title: a & b, in: n1, out: n1}
""",
    "prom_stochastic.pnml": """
net: imported_from__race_pnml_
places: {n1: {title: start, tokens: 1}}
transitions:
  n0: {title: begin, in: n1, out: n1, weight: 2.0}
""",
    "pm4py_alpha.pnml": """
net: net1
places: {start: 1, ___a_b____c______d___: }
rest: start
transitions:
  a_b: {in: start, out: ___a_b____c______d___}
  d: {in: ___a_b____c______d___, out: start}
""",
    "woped_resources.pnml": """
net: noID
places: {p1: {title: registered, tokens: 1}, CENTER_PLACE_t5: }
transitions:
  t5_op_1: {title: check, in: p1, out: CENTER_PLACE_t5}
  t5_op_2: {title: check, in: CENTER_PLACE_t5, out: p1}
""",
    "woped_split.pnml": """
net: noID
places: {p1: {title: order in, tokens: 1}, p2: }
transitions:
  t1_op_1: {title: check, in: p1, out: p2}
  t1_op_2: {title: check, in: p1, out: p1}
""",
    "tapaal_untimed.pnml": """
net: Belt
places: {P0: {title: waiting, tokens: 2}, P1: }
transitions:
  T0: {title: go, in: {P0: 2}, out: {P1: 2}}
  T1: {in: {P1: 2}, inhibitors: P0, out: {P0: 2}}
""",
    "tapaal_dots.tapn": """
net: Belt
places: {P0: 2, P1: }
transitions:
  T0: {in: {P0: 2}, out: P1}
  T1: {in: P1, inhibitors: P0, out: {P0: 2}}
""",
    "pipe_gspn.xml": """
net: Net_One
places: {P0: {title: free, tokens: 1}, P1: {capacity: 2}}
transitions:
  T0: {title: come, in: P0, inhibitors: {P1: 2}, out: [P0, P1], delay: {exponential: {rate: 2.5}}}
  T1: {in: P1, weight: 3.0}
  T2: {in: {P1: 2}, priority: 1}
""",
    "pipe_infinite_server.xml": """
net: Net_One
places: {P0: {title: free, tokens: 1}, P1: {capacity: 2}}
transitions:
  T0: {title: come, in: P0, inhibitors: {P1: 2}, out: [P0, P1], delay: {exponential: {rate: 2.5}}, servers: inf}
  T1: {in: P1, weight: 3.0}
  T2: {in: {P1: 2}, priority: 1}
""",
    "pipe_inhibitor.xml": """
net: net
places: {P0: , P1: 1}
transitions:
  T0: {in: P1, inhibitors: P0, out: P1, delay: {exponential: {rate: 6.0}}}
""",
    "tina_kinds.pnml": """
net: n_3398_81D21_0
description: frozenDoor
places: {t43: {title: door open, tokens: 1}, p: }
transitions:
  t: {title: open, in: {t43: 1, p: 2}, inhibitors: {p: 5}, out: {t43: 1, p: 2}}
""",
    "tina_untimed.pnml": """
net: cell
places: {p_0: {title: p0, tokens: 1}, p_1: }
transitions:
  t_0: {title: t0, in: p_0, out: p_1}
  t_1: {in: {p_1: 2}, out: [p_0, p_1]}
""",
    "tina_exact.pnml": """
net: cell
places: {p_0: {title: p0, tokens: 1}, p_1: }
transitions:
  t_0: {title: t0, in: p_0, out: p_1, delay: 4.0}
  t_1: {in: {p_1: 2}, out: [p_0, p_1]}
""",
    "greatspn_gspn.pnml": """
net: N
description: server
places: {think: 3, ready: }
transitions:
  ask: {in: think, out: ready, delay: {exponential: {mean: 2.0}}}
  answer: {in: ready, out: think}
""",
    "greatspn_inhibitor.pnml": """
net: PT
places: {P0: 2, P1: 1}
transitions:
  T0: {in: P1, inhibitors: {P0: 3}, out: P0}
""",
    "snakes_plain.pnml": """
net: Simple_P_T_net
places: {p2: , p1: 1}
transitions:
  t1: {in: p1, out: p2}
  t2: {in: p2, out: p1}
""",
    "snakes_black.pnml": """
net: N
places: {p: 2, q: 4, r: }
transitions:
  t: {in: {p: 1, q: 2}, out: r}
  u: {in: r, inhibitors: p, out: r}
""",
}

REFUSALS = {
    "pm4py_distribution.pnml": r":7:\d+: toolspecific: distribution 'EXPONENTIAL' .*IMMEDIATE and.*transition 'bad'",
    "pm4py_data.pnml": r":3:\d+: transition 't': attribute 'guard' is not understood; allowed are delay, id",
    "prom_stochastic_key.pnml": r":6:\d+: property: 'guardParameters' is not understood in toolspecific of Stoch",
    "greatspn_colours.pnml": r"net 'SN': type '.*symmetricnet' is a coloured or high-level net; place/transition",
    "prom_reset.pnml": r":4:\d+: arc '2': type 'reset' is not understood; allowed are normal, inhibitor and test",
    "prom_weight_in_name.pnml": r"arc '2': says the weight 3 in its name, and 1 otherwise; one is allowed",
    "woped_subprocess.pnml": r"net: is not understood in page; allowed are arc, .*\(in page 'sub1'\)",
    "tapaal_age.pnml": r"inscription: takes tokens of age \(2,inf\) alone; .*\[0,inf\) is allowed \(in arc 'A2'\)",
    "tapaal_transport_age.pnml": r"takes tokens of age \[0,4\] alone; .*\(in arc 'A0'\)",
    "tapaal_invariant.pnml": r"place 'P0': invariant '<= 7' bounds the age of its tokens; .*'< inf' is allowed",
    "tapaal_game.pnml": r"transition 'T0': belongs to the environment of a game \(player\); allowed is 0",
    "tapaal_constant.pnml": r"weight: 'n' is not a whole number from 1 to \d+ \(in arc 'A2'\)",
    "tapaal_stochastic.tapn": r"transition 'T0': attribute 'distribution' is not understood; allowed are delay",
    "tapaal_shared.pnml": r"shared-place: is not understood in pnml; allowed are finalmarkings, net",
    "pipe_classes.xml": r"place 'P1': the net has tokens of several classes \(Default and Red\): it is coloured",
    "pipe_marking_rate.xml": r"rate: '2\*#\(P0\)' is not a number > 0 \(in transition 'T0'\)",
    "tina_interval.pnml": r"delay: '\[4,9\]' leaves the time open; allowed are \[a,a\] and .*\(in transition 't-0'",
    "tina_mixed.pnml": r"transition 't-1': may wait as long as it likes, while 't-0' waits for a given time",
    "tina_stopwatch.pnml": r"arc 'e-4': type 'stopwatch' is not understood",
    "snakes_values.pnml": r"object: is not understood; black tokens are counted.*\(in place 'q'\)",
    "snakes_variable.pnml": r"variable: is not understood; black tokens are counted.*\(in arc 'q:t'\)",
    "snakes_flush.pnml": r"flush: is not understood",
    "snakes_condition.pnml": r"inhibitor: the condition 'x < 3' looks at values, of a coloured net; allowed is True",
    "snakes_type.pnml": r"type: is of a coloured net",
    "cpn_ide_model.xml": r"workspaceElements: is not the root of a PNML file; 'pnml' is",
    "cpn_ide_export.pnml": r"initialMarking: '1`1\+\+1`2' is not a whole number",
}


def plain(name):
    """A name as YAML can have it."""
    name = re.sub(r"\W", "_", name)
    return f"t{name}" if name[0].isdigit() else name


def shown(net):
    """The names that people see."""
    return [part.title or part.name for part in (*net.places.values(), *net.transitions.values())]


@pytest.mark.parametrize("file", MEANINGS)
def test_a_net_of_another_tool_is_read_with_its_meaning(file):
    net, meant = load_net(FOREIGN / file), parse_net(MEANINGS[file])
    assert (net.name, net.description, net.rest) == (meant.name, meant.description, meant.rest)
    for name, place in net.places.items():
        other = meant.places[plain(name)]
        assert (place.title, place.tokens, place.capacity) == (other.title, other.tokens, other.capacity)
    for name, t in net.transitions.items():
        other = meant.transitions[plain(name)]
        arcs = [{plain(place): n for place, n in arcs.items()} for arcs in (t.inputs, t.outputs, t.inhibitors)]
        assert arcs == [other.inputs, other.outputs, other.inhibitors]
        assert (t.title, t.delay, t.weight, t.priority) == (other.title, other.delay, other.weight, other.priority)
    assert len(net.places) == len(meant.places)
    assert len(net.transitions) == len(meant.transitions)


@pytest.mark.parametrize("file", REFUSALS)
def test_what_has_no_meaning_here_is_refused_by_name(file):
    with pytest.raises(NetFileError, match=REFUSALS[file]):
        load_net(FOREIGN / file)


def test_each_file_is_read_or_refused():
    assert {file.name for file in FOREIGN.iterdir()} == MEANINGS.keys() | REFUSALS.keys()


@pytest.mark.parametrize("file", MEANINGS)
def test_names_of_people_survive_a_way_through_each_format(file, tmp_path):
    net = load_net(FOREIGN / file)
    ours = tmp_path / "ours.pnml"
    ours.write_text(pnml_text(net), encoding="utf-8")
    assert shown(load_net(ours)) == shown(net)
    assert all(place.title in yaml_text(net) for place in net.places.values())


NET = '<pnml {pnml}><net id="n" {net}>{in_net}<place id="p" {place}>{in_place}</place><transition id="t" {transition}>\
{in_transition}</transition><arc source="p" target="t" id="a" {arc}>{in_arc}</arc></net></pnml>'
DOTS = '<hlinitialMarking><structure><numberof><numberconstant value="2"/><useroperator declaration="{}"/></numberof>\
</structure></hlinitialMarking>'
SLOTS = ("pnml", "net", "in_net", "place", "in_place", "transition", "in_transition", "arc", "in_arc")


def written(**slots):
    return NET.format(**(dict.fromkeys(SLOTS, "") | slots))


def read(tmp_path, text):
    file = tmp_path / "net.pnml"
    file.write_text(text, encoding="utf-8")
    return load_net(file)


@given(slot=st.sampled_from(SLOTS), name=st.from_regex("[a-z]{3,8}", fullmatch=True).map(lambda name: f"zz{name}"))
def test_no_unknown_part_passes(tmp_path_factory, slot, name):
    part = f"<{name}>1</{name}>" if slot.startswith("in_") else f'{name}="1"'
    with pytest.raises(NetFileError, match=rf"{name}.* not understood"):
        read(tmp_path_factory.getbasetemp(), written(**{slot: part}))


@pytest.mark.parametrize(
    ("slots", "complaint"),
    [
        ({"in_place": "<initialMarking><bag>2</bag></initialMarking>"}, "bag: is not understood; black tokens"),
        ({"in_place": "<initialMarking>1<text>2</text></initialMarking>"}, "says another thing beside text"),
        ({"in_place": "<initialMarking>1<multiset/></initialMarking>"}, "says another thing beside multiset"),
        ({"in_place": '<initialMarking value="1"><text>2</text></initialMarking>'}, "says another thing beside text"),
        ({"in_place": "<initialMarking><text>1</text><text>2</text></initialMarking>"}, "text: is not understood"),
        ({"in_place": "<capacity/><capacity/>"}, "capacity: is there twice in place"),
        ({"place": 'initialMarking="1"', "in_place": "<initialMarking/>"}, "initialMarking: is there twice in place"),
        ({"in_place": "many"}, "place 'p': the text 'many' is not understood in place"),
        ({"place": 'xmlns:o="urn:o" o:tokens="2"'}, "attribute 'urn:o tokens' is not understood"),
        ({"in_place": '<o:age xmlns:o="urn:o"/>'}, "age: is not understood in place"),
        ({"in_transition": "<timed><value>maybe</value></timed>"}, "timed: 'maybe' is neither true nor false"),
        ({"in_transition": "<timed>true</timed>"}, "transition 't': is timed, and says no 'rate'"),
        ({"in_transition": "<rate>0</rate>"}, "rate: '0' is not a number > 0"),
        ({"in_transition": "<delay>soon</delay>"}, r"delay: 'soon' is not an interval, such as \[0,inf\)"),
        ({"in_transition": "<rate>1</rate><delay>[2,2]</delay>"}, r"has both the rate 1 and the interval \[2,2\]"),
        ({"transition": 'urgent="perhaps"'}, r"urgent: 'perhaps' is neither true nor false \(in transition 't'\)"),
        ({"arc": 'weight="2"', "in_arc": "<inscription>3</inscription>"}, "says the weights 2 and 3; one is allowed"),
        (
            {"place": 'initialMarking="1"', "in_place": DOTS.format("dot")},
            "says 2 dots, and initialMarking 1; one number",
        ),
        ({"place": 'initialMarking="2"', "in_place": DOTS.format("red")}, "hlinitialMarking: is of a coloured net"),
        ({"in_place": "<type><structure><usersort declaration='red'/></structure></type>"}, "is of a coloured net"),
        ({"arc": 'type="test"', "in_arc": '<type value="inhibitor"/>'}, "type: is there twice"),
        ({"arc": 'type="test"', "in_arc": "<arctype>inhibitor</arctype>"}, "says the types test and inhibitor"),
        ({"net": 'type="http://x/elementaryNet"'}, "type 'http://x/elementaryNet' is not understood; place/transition"),
        ({"in_net": '<finalmarkings><marking><place idref="q"/></marking></finalmarkings>'}, "there is no place 'q'"),
    ],
)
def test_nothing_counts_as_its_default(tmp_path, slots, complaint):
    with pytest.raises(NetFileError, match=complaint):
        read(tmp_path, written(**slots))


def test_an_empty_final_marking_is_an_empty_rest(tmp_path):
    assert read(tmp_path, written()).rest is None
    assert read(tmp_path, written(in_net="<finalmarkings/>")).rest is None
    assert read(tmp_path, written(in_net="<finalmarkings><marking/></finalmarkings>")).rest == ()


@pytest.mark.parametrize("encoding", ["iso-8859-1", "utf-8"])
def test_a_file_that_declares_latin_1_is_read_as_it_was_written(tmp_path, encoding):
    text = '<?xml version="1.0" encoding="iso-8859-1"?>' + written(in_place="<name><value>Förderband</value></name>")
    file = tmp_path / "net.xml"
    file.write_bytes(text.encode(encoding))
    assert load_net(file).places["p"].title == "Förderband"
