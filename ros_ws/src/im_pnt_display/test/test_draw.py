from dataclasses import replace
from itertools import combinations, pairwise
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_pnt.model.action import FunctionAction, ValuesAction
from im_pnt.model.delay import Delay
from im_pnt.model.net import LARGEST, Guard, Net, Place, Transition
from im_pnt.netfile import load_net, parse_net
from im_pnt_display import dot, draw, svg
from im_pnt_display.drawing.layout import NodeBox, layered

boxes = st.builds(NodeBox, st.floats(5, 60), st.floats(5, 60), st.floats(10, 50))


@st.composite
def graphs(draw_):
    names = [f"n{index}" for index in range(draw_(st.integers(1, 14)))]
    pair = st.tuples(st.sampled_from(names), st.sampled_from(names)).filter(lambda edge: edge[0] != edge[1])
    edges = draw_(st.lists(pair, max_size=24)) if len(names) > 1 else []
    return {name: draw_(boxes) for name in names}, edges


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_no_two_nodes_overlap_and_all_are_inside(graph):
    rooms, edges = graph
    layout = layered(rooms, edges)
    frames = {
        name: (x - rooms[name].left, y - rooms[name].height / 2, x + rooms[name].right, y + rooms[name].height / 2)
        for name, (x, y) in layout.positions.items()
    }
    assert frames.keys() == rooms.keys()
    for left, upper, right, lower in frames.values():
        assert min(left, upper) >= -1e-6
        assert right <= layout.width + 1e-6
        assert lower <= layout.height + 1e-6
    for a, b in combinations(frames.values(), 2):
        assert a[2] <= b[0] + 1e-6 or b[2] <= a[0] + 1e-6 or a[3] <= b[1] + 1e-6 or b[3] <= a[1] + 1e-6


@settings(max_examples=60, deadline=None)
@given(graphs())
def test_edges_run_one_way_and_pass_beside_the_nodes(graph):
    rooms, edges = graph
    layout = layered(rooms, edges)
    for a, b in edges:
        route = layout.routes[a, b]
        heights = [layout.positions[a][1], *(y for _, y in route), layout.positions[b][1]]
        assert heights in (sorted(heights), sorted(heights, reverse=True))
        for (x, y), (u, v) in zip(route[::2], route[1::2], strict=True):
            assert x == u
            for name, (nx, ny) in layout.positions.items():
                if min(y, v) < ny < max(y, v):
                    assert x <= nx - rooms[name].left or x >= nx + rooms[name].right


@pytest.mark.parametrize("phases", [False, True])
def test_a_drawing_has_every_part_and_arcs_from_rim_to_rim(data, phases):
    drawing = draw(load_net(data / "coordinator.yaml"), phases=phases)
    nodes = {node.name: node for node in drawing.nodes}
    assert {"asked", "found", "not_found", "SI", "SO", "accept.find", "t_f.find", "return.find"} <= nodes.keys()
    assert ("search" in nodes) != phases
    assert ("search.active" in nodes) == phases
    for arc, points in zip(drawing.arcs, drawing.points(), strict=True):
        for name, (x, y) in ((arc.source, points[0]), (arc.target, points[-1])):
            (nx, ny), box = drawing.layout.positions[name], nodes[name].box
            assert abs(x - nx) <= box.left
            assert abs(y - ny) <= box.height / 2
        for (x, y), (u, v) in pairwise(points):
            assert (x, y) != (u, v)


def test_semaphores_and_places_with_many_arcs_are_drawn_again_beside_their_transitions(data):
    nodes = {node.name: node for node in draw(load_net(data / "coordinator.yaml")).nodes}
    assert nodes["SI>accept.find"].kind == "reference"
    assert nodes["SI>accept.find"].place == "SI"
    steps = [
        Transition(f"t{k}", {f"p{k}": 1}, {f"p{k + 1}": 1}, action=FunctionAction("f"), on_failure={"lost": 1})
        for k in range(4)
    ]
    places = {name: Place(name) for name in ("p0", "p1", "p2", "p3", "p4", "lost")}
    drawing = draw(Net("n", places, {step.name: step for step in steps}))
    into_lost = {arc.target for arc in drawing.arcs if arc.kind == "failure"}
    assert into_lost == {f"t{k}>lost" for k in range(4)}
    assert {node.place for node in drawing.nodes if node.name in into_lost} == {"lost"}


def test_a_tall_net_goes_on_in_another_column():
    chain = [Transition(f"t{k}", {f"p{k}": 1}, {f"p{k + 1}": 1}) for k in range(16)]
    places = {f"p{k}": Place(f"p{k}", tokens=int(k == 0)) for k in range(17)}
    drawing = draw(Net("chain", places, {step.name: step for step in chain}))
    continued = [node for node in drawing.nodes if node.kind == "reference"]
    assert len(continued) == 1
    assert drawing.layout.height < 1000
    assert drawing.layout.positions[continued[0].place][1] < 50


def test_a_large_net_is_drawn_in_pieces_that_lose_nothing():
    places, transitions = {}, {}
    for k in range(250):
        for kind in ("think", "fork", "left", "eat"):
            places[f"{kind}{k}"] = Place(f"{kind}{k}", tokens=int(kind in ("think", "fork")))
        other = f"fork{(k + 1) % 250}"
        for step in (
            Transition(f"first{k}", {f"think{k}": 1, f"fork{k}": 1}, {f"left{k}": 1}),
            Transition(f"second{k}", {f"left{k}": 1, other: 1}, {f"eat{k}": 1}),
            Transition(f"drop{k}", {f"eat{k}": 1}, {f"think{k}": 1, f"fork{k}": 1, other: 1}),
        ):
            transitions[step.name] = step
    drawing = draw(Net("ring", places, transitions))
    nodes = {node.name: node for node in drawing.nodes}
    shown = [tuple(nodes[end].place or end for end in (arc.source, arc.target)) for arc in drawing.arcs]
    arcs = [(place, t.name) for t in transitions.values() for place in t.inputs]
    arcs += [(t.name, place) for t in transitions.values() for place in t.outputs]
    assert sorted(shown) == sorted(arcs)
    assert {node.place for node in drawing.nodes if node.kind == "place"} == places.keys()
    assert drawing.layout.width < 8 * drawing.layout.height


def test_a_place_and_a_transition_of_one_name_are_two_nodes():
    net = Net("n", {"a": Place("a", tokens=1), "b": Place("b")}, {"a": Transition("a", {"a": 1}, {"b": 1})})
    drawing = draw(net)
    assert sorted((node.kind, node.label, node.place) for node in drawing.nodes) == [
        ("place", "a", "a"),
        ("place", "b", "b"),
        ("transition", "a", ""),
    ]
    assert len(drawing.arcs) == 2


def test_a_transition_that_waits_is_an_open_bar_with_its_time():
    waits = Transition("waits", {"a": 1}, {"a": 1}, delay=Delay("constant", (2.5,)))
    acts = Transition("acts", {"a": 1}, {"a": 1}, action=FunctionAction("f"), on_failure={"a": 1}, delay=waits.delay)
    drawing = draw(Net("n", {"a": Place("a", tokens=1)}, {"waits": waits, "acts": acts}))
    assert [node.name for node in drawing.nodes if node.timed] == ["waits"]
    picture = svg(drawing)
    assert "after 2.5 s" in picture
    assert "takes 2.5 s" in picture
    assert picture.count('rx="2" fill="white"') == 1


def test_counted_servers_are_a_note_and_no_place():
    servers = {"waits": 3, "acts": 2, "all": LARGEST}
    waits = Transition("waits", {"a": 1}, {"a": 1}, delay=Delay("constant", (2.5,)))
    acts = replace(waits, name="acts", action=FunctionAction("f"), on_failure={"a": 1})
    every = {t.name: replace(t, servers=servers[t.name]) for t in (waits, acts, replace(waits, name="all"))}
    drawing = draw(Net("n", {"a": Place("a", tokens=1)}, every))
    assert [note for node in drawing.nodes for note in node.notes if "at once" in note] == [
        "3 at once",
        "2 at once",
        "all at once",
    ]
    assert {node.name for node in drawing.nodes if node.kind == "place"} == {"a"}


@pytest.mark.parametrize("name", ['a"b', "a\\", "a<b&c>", "a b.c"])
def test_any_name_makes_a_sound_drawing(name):
    drawing = draw(Net(name, {name: Place(name, tokens=1)}, {"t": Transition("t", {name: 1})}))
    title = ElementTree.fromstring(svg(drawing)).find("{http://www.w3.org/2000/svg}title")
    assert title is not None
    assert title.text == name
    quoted = name.replace("\\", "\\\\").replace('"', '\\"')
    assert f'"{quoted}" -> "t"' in dot(drawing)


def test_expressions_are_shown_as_they_are_written():
    guard = Guard("${answers.look.x < 3 and arguments.n in [1, 2]}", negated=True)
    tells = Transition("tells", {"a": 1}, {"a": 1}, guard=guard, action=ValuesAction(), on_failure={"a": 1})
    tells = replace(tells, result={"x": "${answers.look.x}", "all": {"y": [1, "${" + "1 + " * 40 + "1}"]}})
    drawing = draw(Net("n", {"a": Place("a", tokens=1)}, {"tells": replace(tells, store={"spot": {"x": 1}})}))
    root = ElementTree.fromstring(svg(drawing))
    shown = {text.text for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {f"[{guard}]", "x = ${answers.look.x}", 'spot := {"x": 1}'} <= shown
    assert any(text.startswith('all = {"y": [1, "${1 + 1') and text.endswith("...") for text in shown)
    assert str(guard) in dot(drawing)


def test_an_arc_that_empties_a_place_is_drawn_as_such():
    places = "{a: 1, c: {capacity: 2, resource: true}}"
    drawing = draw(parse_net(f"net: n\nplaces: {places}\ntransitions: {{t: {{in: a, out: [a, c], resets: c}}}}\n"))
    assert '"c" -> "t" [arrowhead=normalnormal];' in dot(drawing)
    assert 'stroke-dasharray="7 2 1 2"' in svg(drawing)


def test_the_usual_part_is_what_tokens_reach_while_nothing_fails():
    net = parse_net(
        """
net: n
places: {idle: 1, here: , there: , lost: , broken: }
transitions:
  go: {in: idle, out: here}
  walk: {in: here, out: there, action: walk, on_failure: lost}
  mend: {in: lost, out: broken}
  give_up: {in: [broken, idle], out: idle}
  back: {in: there, out: idle}
  halt: {in: there, guard: cancelled, out: broken}
""",
        "n.yaml",
    )
    usual, whole = draw(net, usual=True), draw(net)
    assert {node.name for node in usual.nodes} == {"idle", "here", "there", "go", "walk", "back"}
    assert {"mend", "give_up", "halt", "lost", "broken"} < {node.name for node in whole.nodes}
    assert {arc.kind for arc in usual.arcs} == {"flow"}


def test_what_other_nets_mark_is_usual(data):
    """A coordinator is asked by places that none of its transitions marks."""
    names = {node.name for node in draw(load_net(data / "coordinator.yaml"), usual=True).nodes}
    assert {"asked", "found", "accept.find", "return.find"} <= names


PARTS = """
net: n
templates:
  power:
    ports: {in: [wanted, moved, missed], out: [powered, done], on_failure: failed}
    places: {on: }
    transitions:
      up: {in: wanted, out: [powered, on], action: up, on_failure: [missed, on]}
      down: {in: [moved, on], out: done, action: down, on_failure: failed}
      give_up: {in: [missed, on], out: failed, action: down, on_failure: failed}
places: {idle: 1, asked: , done: , failed: }
transitions:
  begin: {symbol: go, in: idle, out: asked}
  go: {with: power, in: asked, out: done, action: go, on_failure: failed}
  end: {in: done, out: idle, emit: go_done}
  end_failed: {in: failed, out: idle, emit: go_failed}
"""


def test_a_subnet_in_use_is_one_box_with_a_double_border_until_its_parts_are_wanted():
    net = parse_net(PARTS)
    folded = draw(net)
    (box,) = [node for node in folded.nodes if node.subnet]
    assert (box.name, box.notes[-1]) == ("go", "4 transitions")
    arcs = {(arc.source, arc.target, arc.kind) for arc in folded.arcs}
    assert {("asked", "go", "flow"), ("go", "done", "flow")} < arcs
    assert not any("." in node.name for node in folded.nodes if node.kind != "reference")
    assert svg(folded).count("<rect") == svg(draw(net, usual=True)).count("<rect") + 1 == 1 + 4 + 1
    assert dot(folded).count("peripheries=2") == 1
    whole = {node.name for node in draw(net, subnets=True).nodes}
    assert {"go", "go.power.up", "go.power.give_up", "go.power.on", "go.power_missed"} < whole
    assert {"go.start", "go.power.up.end"} < {node.name for node in draw(net, phases=True).nodes}


def test_the_usual_part_of_a_subnet_is_what_fires_while_nothing_fails():
    (box,) = [node for node in draw(parse_net(PARTS), usual=True).nodes if node.subnet]
    assert box.notes[-1] == "3 transitions"
