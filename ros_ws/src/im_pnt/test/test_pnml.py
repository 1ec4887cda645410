from collections import deque
from dataclasses import replace

import pytest

from im_pnt.errors import NetFileError
from im_pnt.model.expand import expand
from im_pnt.netfile import load_net
from im_pnt.pnml import pnml_text
from im_pnt_analysis.cli import main
from im_pnt_analysis.cli.terminal import BAD_INPUT, OK
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.verify.verdict import verify
from im_pnt_display import draw


def bare(net):
    """A net without where it came from."""
    lines = {name: replace(t, line=0) for name, t in net.transitions.items()}
    return replace(net, source="", transitions=lines)


TOLERANT = """\
<?xml version="1.0"?>
<pnml><net id="x-1" type="P/T net"><name><value>A net</value></name>
  <place id="P-poss__2_"><name><text>same name</text></name><initialMarking><value>Default,2</value></initialMarking>
    <graphics><position x="1" y="2"/></graphics></place>
  <place id="q.1"><name><text>same name</text></name><initialMarking><text/></initialMarking></place>
  <place id="full"><capacity><value>2</value></capacity></place>
  <transition id="t 1"><rate><value>1.0</value></rate><toolspecific tool="other" version="9"/></transition>
  <page id="g"><page id="h"><referencePlace id="r1" ref="r2"/><transition id="t2"/></page></page>
  <referencePlace id="r2" ref="P-poss__2_"/>
  <arc id="1" source="r1" target="t 1"><inscription><value>2</value></inscription></arc>
  <arc id="2" source="r2" target="t 1"/>
  <arc source="t 1" target="q.1"/>
  <arc id="3" source="q.1" target="t2" type="tapnInhibitor"><inscription><text>3</text></inscription></arc>
  <arc id="4" source="P-poss__2_" target="t2"><type value="test"/></arc>
  <arc id="5" source="t2" target="full"/>
</net></pnml>
"""


def read(tmp_path, text):
    file = tmp_path / "net.pnml"
    file.write_text(text, encoding="utf-8")
    return load_net(file)


def test_what_tools_write_is_read(tmp_path):
    net = read(tmp_path, TOLERANT)
    assert (net.name, net.description) == ("x_1", "A net")
    assert {place.name: place.tokens for place in net.places.values()} == {"P-poss__2_": 2, "q.1": 0, "full": 0}
    first, second = net.transitions.values()
    assert (first.inputs, first.outputs, first.inhibitors) == ({"P-poss__2_": 3}, {"q.1": 1}, {})
    assert (second.inputs, second.outputs) == ({"P-poss__2_": 1}, {"P-poss__2_": 1, "full": 1})
    assert second.inhibitors == {"q.1": 3, "full": 2}


def test_any_name_goes_through_the_whole_of_analysis_and_drawing(tmp_path):
    net = read(tmp_path, TOLERANT)
    report = verify([net])
    assert report.states == 3
    assert report.bounded
    other = replace(net, name="other")
    assert len(compose([net, other]).net.places) == 2 * len(net.places)
    assert {"q.1", "t 1"} <= {node.name for node in draw(net).nodes}
    assert expand(net).places == net.places
    assert bare(read(tmp_path, pnml_text(net))) == bare(net)


@pytest.mark.parametrize(
    ("find", "replacement", "complaint"),
    [
        ("<?xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><x/><?xml", "not XML|document type"),
        ("<pnml>", "<!DOCTYPE pnml SYSTEM 'http://x/y'><pnml>", r"net.pnml:2:\d+: document type 'pnml' is not allowed"),
        ("<pnml>", "<!DOCTYPE workspaceElements PUBLIC 'a' 'b'><pnml>", "is of CPN Tools, whose nets are coloured"),
        ("</pnml>", "", "not XML: no element found"),
        ("pnml>", "svg>", "svg: is not the root of a PNML file"),
        ("<net ", "<nets ", "not XML: mismatched tag"),
        ('"P/T net"', '"http://www.pnml.org/version-2009/grammar/symmetricnet"', "symmetricnet' is a coloured"),
        ("<initialMarking><text/></initialMarking>", "<hlinitialMarking/>", r":5:\d+: hlinitialMarking: is of a col"),
        ("<text/>", "<text>-1</text>", r":5:\d+: initialMarking: '-1' is not a whole number from 0"),
        ("<text/>", "<text>99999999999</text>", "'99999999999' is not a whole number"),
        ("<text>3</text>", "<text>0</text>", r":13:\d+: inscription: '0' is not a whole number from 1"),
        ('"tapnInhibitor"', '"reset"', r":13:\d+: arc '3': type 'reset' is not understood; allowed are normal, inh"),
        ('id="q.1"', 'id="full"', "place 'full': the id is there twice; the first is in line"),
        ('id="q.1"', "", "place: needs an 'id'"),
        ('target="q.1"', 'target="q1"', r"arc: there is no place or transition 'q1' \(did you mean 'q.1'"),
        ('target="q.1"', 'target="t2"', "joins 't 1' and 't2'; an arc joins a place and a transition"),
        ('source="t 1" target="q.1"', 'target="q.1"', "arc: 'source' is missing"),
        ('ref="P-poss__2_"', 'ref="r1"', "references go round: r1 -> r2 -> r1"),
        ('ref="P-poss__2_"', 'ref="P"', r"referencePlace 'r2': there is no place or transition 'P'"),
        ("<capacity>", "<bag>1</bag><capacity>", r"bag: is not understood in place; allowed are capacity, "),
        ("<capacity>", "<initialMarking><text>3</text></initialMarking><capacity>", "3 tokens are more than the cap"),
        ('source="q.1"', 'source="full" weight="x"', r"weight: 'x' is not a whole number .*\(in arc '3'\)"),
    ],
)
def test_what_is_not_understood_is_named(tmp_path, find, replacement, complaint):
    assert find in TOLERANT
    text = TOLERANT.replace(find, replacement, 2 if find == "pnml>" else 1)
    text = text.replace("<pnml>", "<svg>") if find == "pnml>" else text
    with pytest.raises(NetFileError, match=complaint):
        read(tmp_path, text)


@pytest.mark.parametrize("dot", ["", "."])
def test_one_net_of_several_is_asked_for_by_name(tmp_path, dot):
    net = '<net id="{0}"><place id="p"/><transition id="t"/><arc source="p" target="t"/></net>'
    with pytest.raises(NetFileError, match=rf"holds 2 nets: a{dot}a, b{dot}b; say which, as in .*net\.pnml#a{dot}a"):
        read(tmp_path, f"<pnml>{net.format(f'a{dot}a')}{net.format(f'b{dot}b')}</pnml>")
    assert load_net(tmp_path / f"net.pnml#b{dot}b").transitions
    with pytest.raises(NetFileError, match=rf"there is no net 'c' \(known: a{dot}a, b{dot}b\)"):
        load_net(tmp_path / "net.pnml#c")


@pytest.mark.parametrize(
    "content",
    [
        '<im:guard>"not g"</im:guard><im:guard>"g"</im:guard>',
        "<im:guard>not g</im:guard>",
        '<im:gard>"g"</im:gard>',
        "<im:timeout>NaN</im:timeout>",
        "<guard>1</guard>",
        '<im:in>["p"]</im:in>',
        '<im:action>"f"</im:action>',
        f"<im:message>{'[' * 300}{']' * 300}</im:message>",
        f"<im:message>{'[' * 100_000}</im:message>",
    ],
)
def test_damage_to_what_is_ours_is_named(tmp_path, content):
    tool = f'<toolspecific tool="im" version="1" xmlns:im="urn:im:pnt:net:1">{content}</toolspecific>'
    arc = '<place id="p"/><arc source="p" target="t"/>'
    with pytest.raises(NetFileError, match=r"net\.pnml:1:\d+: "):
        read(tmp_path, f'<pnml><net id="n"><transition id="t">{tool}</transition>{arc}</net></pnml>')


@pytest.mark.parametrize("name", ["[]", '""', "null", "{}"])
def test_a_place_of_another_net_has_a_name(tmp_path, name):
    tool = f'<toolspecific tool="im" version="1" xmlns:im="urn:im:pnt:net:1"><im:remote_place>{name}</im:remote_place>'
    arcs = '<place id="p"/><arc source="p" target="t"/><transition id="t"/><arc source="t" target="q"/>'
    with pytest.raises(NetFileError, match=r"net\.pnml:1:\d+: remote_place: .* is not the name of a place of another"):
        read(tmp_path, f'<pnml><net id="n">{arcs}<place id="q">{tool}</toolspecific></place></net></pnml>')


def reachability_graph(net, places):
    """Arcs of the reachability graph, seen on some places alone."""
    first = tuple(place.tokens for place in net.places.values())
    index = {name: number for number, name in enumerate(net.places)}
    seen, arcs, queue = {first}, set(), deque([first])
    while queue:
        marking = queue.popleft()
        for t in net.transitions.values():
            short = any(marking[index[name]] < weight for name, weight in t.inputs.items())
            if short or any(marking[index[name]] >= weight for name, weight in t.inhibitors.items()):
                continue
            after = list(marking)
            for name, weight in t.inputs.items():
                after[index[name]] -= weight
            for name, weight in t.outputs.items():
                after[index[name]] += weight
            arcs.add((*(tuple(m[index[name]] for name in places) for m in (marking, after)), t.name))
            if tuple(after) not in seen:
                seen.add(tuple(after))
                queue.append(tuple(after))
    return len(seen), arcs


def test_convert_goes_both_ways_and_never_overwrites_unasked(data, tmp_path, capsys):
    source, pnml, back = data / "coordinator.yaml", tmp_path / "c.pnml", tmp_path / "c.yaml"
    assert main(["convert", str(source), str(pnml)]) == OK
    assert "only pnt will see services: find" in capsys.readouterr().err
    assert main(["convert", str(pnml), str(back)]) == OK
    assert bare(load_net(back)) == bare(load_net(source))
    before = back.read_text()
    assert main(["convert", str(pnml), str(back)]) == BAD_INPUT
    assert "is there already; --force overwrites it" in capsys.readouterr().err
    assert back.read_text() == before
    assert main(["convert", str(pnml), str(back), "--force"]) == OK
    assert main(["convert", str(source), str(tmp_path / "c.pdf")]) == BAD_INPUT
    assert main(["convert", str(source), str(tmp_path / "no" / "c.pnml")]) == BAD_INPUT
    assert {file.name for file in tmp_path.iterdir()} == {"c.pnml", "c.yaml"}


def test_names_that_yaml_cannot_have_are_changed_and_said(tmp_path, capsys):
    read(tmp_path, TOLERANT)
    assert main(["convert", str(tmp_path / "net.pnml"), str(tmp_path / "net.yaml")]) == OK
    assert "'q.1' is named q_1" in capsys.readouterr().err
    renamed, net = load_net(tmp_path / "net.yaml"), load_net(tmp_path / "net.pnml")
    mine, theirs = (reachability_graph(each, list(each.places)) for each in (renamed, net))
    assert mine[0] == theirs[0]
    assert {arc[:2] for arc in mine[1]} == {arc[:2] for arc in theirs[1]}
