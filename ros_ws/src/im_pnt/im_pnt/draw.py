"""Drawings of nets: SVG to look at, DOT for other tools, positions for the live display."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html import escape

from im_pnt.expand import OUTPUT_SEMAPHORE, expand, input_place
from im_pnt.layout import Layout, Point, layered
from im_pnt.net import Net, Place, RequestAction, Role, Transition

_RADIUS = 11.0
_HEIGHT = 22.0
_MARGIN = 30.0


@dataclass(frozen=True, slots=True)
class DrawnNode:
    """A place or transition of a drawing; ``link`` is the ``net.place`` of another net that it leads to."""

    name: str
    kind: str
    label: str
    note: str
    tokens: int
    width: float
    link: str = ""


@dataclass(frozen=True, slots=True)
class DrawnArc:
    """An arc of a drawing; ``kind`` is ``flow``, ``failure`` (dashed) or ``inhibitor`` (ends in a circle)."""

    source: str
    target: str
    weight: int
    kind: str


@dataclass(frozen=True, slots=True)
class Drawing:
    """A net with the places of its parts."""

    net: str
    nodes: tuple[DrawnNode, ...]
    arcs: tuple[DrawnArc, ...]
    layout: Layout

    def to_dict(self) -> dict[str, object]:
        """Returns what a display needs, as plain data; coordinates in pixels."""
        layout = self.layout
        nodes = [
            {
                "name": node.name,
                "kind": node.kind,
                "label": node.label,
                "note": node.note,
                "link": node.link,
                "width": node.width,
                "x": round(layout.positions[node.name][0] + _MARGIN, 1),
                "y": round(layout.positions[node.name][1] + _MARGIN, 1),
            }
            for node in self.nodes
        ]
        arcs = [
            {
                "source": arc.source,
                "target": arc.target,
                "weight": arc.weight,
                "kind": arc.kind,
                "points": [[round(x + _MARGIN, 1), round(y + _MARGIN, 1)] for x, y in self.points(arc)],
            }
            for arc in self.arcs
        ]
        size = [round(layout.width + 2 * _MARGIN), round(layout.height + 2 * _MARGIN)]
        return {"net": self.net, "nodes": nodes, "arcs": arcs, "size": size}

    def points(self, arc: DrawnArc) -> list[Point]:
        """Returns the points of an arc, from rim to rim."""
        by_name = {node.name: node for node in self.nodes}
        positions = self.layout.positions
        key = (arc.source, arc.target)
        inner = self.layout.routes.get(key)
        if inner is None:
            inner = self.layout.routes[arc.target, arc.source][::-1]
        path = [positions[arc.source], *inner, positions[arc.target]]
        path[0] = _rim(by_name[arc.source], path[0], path[1])
        path[-1] = _rim(by_name[arc.target], path[-1], path[-2])
        return path


def draw(net: Net, *, phases: bool = False) -> Drawing:
    """Lays out a net.

    Args:
        net: The net as written; its coordination structures are drawn with it.
        phases: Draw start, active, end and failed of timed transitions; otherwise one box each.
    """
    whole = expand(net)
    shown = whole if phases else _folded(net, whole)
    nodes = tuple(_nodes(shown))
    arcs = tuple(_arcs(shown))
    top = [node.name for node in nodes if node.tokens and node.name != OUTPUT_SEMAPHORE]
    layout = layered({node.name: node.width for node in nodes}, [(arc.source, arc.target) for arc in arcs], top)
    return Drawing(net.name, nodes, arcs, layout)


def svg(drawing: Drawing, tokens: Mapping[str, int] | None = None) -> str:
    """Returns a drawing as an SVG document.

    Args:
        drawing: What to draw.
        tokens: Marking to show; None: the initial one.
    """
    width = drawing.layout.width + 2 * _MARGIN
    height = drawing.layout.height + 2 * _MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="{-_MARGIN:g} {-_MARGIN:g} {width:.0f} {height:.0f}" font-family="sans-serif" font-size="11">',
        f"<title>{escape(drawing.net)}</title>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" '
        'orient="auto-start-reverse"><path d="M0 0 8 4 0 8z"/></marker></defs>',
        f'<rect x="{-_MARGIN:g}" y="{-_MARGIN:g}" width="{width:.0f}" height="{height:.0f}" fill="white"/>',
    ]
    lines.extend(_svg_arc(drawing, arc) for arc in drawing.arcs)
    for node in drawing.nodes:
        count = node.tokens if tokens is None else tokens.get(node.name, 0)
        lines.append(_svg_node(node, drawing.layout.positions[node.name], count))
    return "\n".join([*lines, "</svg>", ""])


def dot(drawing: Drawing) -> str:
    """Returns a drawing in the DOT language."""
    lines = [f'digraph "{drawing.net}" {{', "  rankdir=TB; node [fontsize=10];"]
    for node in drawing.nodes:
        shape = "circle" if node.kind == "place" else "box"
        mark = f"\\n{node.tokens}" if node.tokens else ""
        note = f"\\n{_quoted(node.note)}" if node.note else ""
        lines.append(f'  "{node.name}" [shape={shape} label="{node.label}{mark}{note}"];')
    styles = {"flow": "", "failure": " style=dashed", "inhibitor": " arrowhead=odot"}
    for arc in drawing.arcs:
        weight = f' label="{arc.weight}"' if arc.weight > 1 else ""
        lines.append(f'  "{arc.source}" -> "{arc.target}" [{(styles[arc.kind] + weight).strip()}];')
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _folded(net: Net, whole: Net) -> Net:
    """The net as written, with the coordination structures of the expanded one."""
    structure = {
        name: t
        for name, t in whole.transitions.items()
        if t.role not in (Role.PLAIN, Role.START, Role.END, Role.FAILED)
    }
    hidden = {f"{name}.active" for name, t in net.transitions.items() if t.action is not None}
    places = {name: place for name, place in whole.places.items() if name not in hidden}
    return Net(net.name, places, {**net.transitions, **structure}, escalate=net.escalate)


def _nodes(net: Net) -> Iterator[DrawnNode]:
    def place_node(place: Place) -> DrawnNode:
        note = f"object {place.data_object}" if place.data_object else ""
        width = 2 * _RADIUS + 2 * 6.2 * len(place.name)
        return DrawnNode(place.name, "place", place.name, note, place.tokens, width)

    for place in net.places.values():
        if place.tokens:
            yield place_node(place)
    for transition in net.transitions.values():
        label = transition.name
        action = transition.action
        link = f"{action.net}.{input_place(action.service)}" if isinstance(action, RequestAction) else ""
        yield DrawnNode(label, "transition", label, _note(transition), 0, max(40.0, 6.6 * len(label) + 12), link)
    for place in net.places.values():
        if not place.tokens:
            yield place_node(place)
    for name in sorted({str(remote) for t in net.transitions.values() for remote in t.remote_outputs}):
        yield DrawnNode(name, "remote", name, "place of another net", 0, 2 * _RADIUS + 2 * 6.2 * len(name), name)


def _note(transition: Transition) -> str:
    parts = [f"symbol {transition.symbol}"] if transition.symbol else []
    parts += [f"guard {transition.guard}"] if transition.guard else []
    parts += [str(transition.action)] if transition.action else []
    parts += [f"emits {', '.join(transition.emit)}"] if transition.emit else []
    return "; ".join(parts)


def _arcs(net: Net) -> Iterator[DrawnArc]:
    for t in net.transitions.values():
        for place, weight in t.inputs.items():
            yield DrawnArc(place, t.name, weight, "flow")
        for place, weight in t.inhibitors.items():
            yield DrawnArc(place, t.name, weight, "inhibitor")
        for place, weight in t.outputs.items():
            yield DrawnArc(t.name, place, weight, "flow")
        for remote, weight in t.remote_outputs.items():
            yield DrawnArc(t.name, str(remote), weight, "flow")
        failure = t.on_failure or ({net.escalate: 1} if t.action is not None and net.escalate else {})
        for place, weight in failure.items():
            yield DrawnArc(t.name, place, weight, "failure")


def _rim(node: DrawnNode, centre: Point, toward: Point) -> Point:
    dx, dy = toward[0] - centre[0], toward[1] - centre[1]
    length = (dx * dx + dy * dy) ** 0.5 or 1.0
    if node.kind != "transition":
        return centre[0] + dx / length * _RADIUS, centre[1] + dy / length * _RADIUS
    half_width, half_height = node.width / 2, _HEIGHT / 2
    scale = min(half_width / abs(dx) if dx else 1e9, half_height / abs(dy) if dy else 1e9)
    return centre[0] + dx * scale, centre[1] + dy * scale


def _svg_arc(drawing: Drawing, arc: DrawnArc) -> str:
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in drawing.points(arc))
    style = {
        "flow": 'stroke="#333" marker-end="url(#tip)"',
        "failure": 'stroke="#b33" stroke-dasharray="4 3" marker-end="url(#tip)"',
        "inhibitor": 'stroke="#333" stroke-dasharray="1 3"',
    }[arc.kind]
    line = f'<polyline fill="none" stroke-linejoin="round" {style} points="{points}"/>'
    x, y = drawing.points(arc)[-1]
    if arc.kind == "inhibitor":
        line += f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="white" stroke="#333"/>'
    if arc.weight > 1:
        line += f'<text x="{x + 5:.1f}" y="{y - 6:.1f}">{arc.weight}</text>'
    return line


def _svg_node(node: DrawnNode, at: Point, tokens: int) -> str:
    x, y = at
    title = f"<title>{escape(node.note)}</title>" if node.note else ""
    if node.kind == "transition":
        half = node.width / 2
        return (
            f'<g>{title}<rect x="{x - half:.1f}" y="{y - _HEIGHT / 2:.1f}" width="{node.width:.1f}" '
            f'height="{_HEIGHT:g}" rx="2" fill="#dfe8f2" stroke="#245"/>'
            f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{escape(node.label)}</text></g>'
        )
    dash = ' stroke-dasharray="3 2"' if node.kind == "remote" else ""
    mark = "" if not tokens else f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{tokens}</text>'
    if tokens == 1:
        mark = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="#111"/>'
    return (
        f'<g>{title}<circle cx="{x:.1f}" cy="{y:.1f}" r="{_RADIUS:g}" fill="white" stroke="#245"{dash}/>{mark}'
        f'<text x="{x + _RADIUS + 4:.1f}" y="{y + 4:.1f}">{escape(node.label)}</text></g>'
    )
