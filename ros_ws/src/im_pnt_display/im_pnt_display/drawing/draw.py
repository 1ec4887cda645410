"""Drawings of nets: SVG to look at, DOT for other tools, positions for the live display."""

from dataclasses import dataclass
from html import escape
from itertools import pairwise

from im_pnt.model.expand import OUTPUT_SEMAPHORE
from im_pnt.model.net import Net
from im_pnt_display.drawing.layout import GraphLayout, Point, layered
from im_pnt_display.drawing.parts import LINE, RADIUS, REFERENCE_RADIUS, DrawnArc, DrawnNode, parts

_MARGIN = 24.0
_PORT = 14.0


@dataclass(frozen=True, slots=True)
class Drawing:
    """Net with the places of the parts."""

    net: str
    nodes: tuple[DrawnNode, ...]
    arcs: tuple[DrawnArc, ...]
    layout: GraphLayout

    def to_dict(self) -> dict[str, object]:
        """Return the drawing for a display, as plain data; coordinates in pixels."""
        layout = self.layout
        nodes = [
            {
                "name": node.name,
                "kind": node.kind,
                "label": node.label,
                "notes": node.notes,
                "place": node.place,
                "link": node.link,
                "timed": node.timed,
                "subnet": node.subnet,
                "box": [round(side, 1) for side in node.box],
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
                "path": path([(x + _MARGIN, y + _MARGIN) for x, y in points]),
                "tip": [round(points[-1][0] + _MARGIN, 1), round(points[-1][1] + _MARGIN, 1)],
            }
            for arc, points in zip(self.arcs, self.points(), strict=True)
        ]
        size = [round(layout.width + 2 * _MARGIN), round(layout.height + 2 * _MARGIN)]
        return {"net": self.net, "nodes": nodes, "arcs": arcs, "size": size}

    def points(self) -> list[list[Point]]:
        """Return the points of each arc from rim to rim; the arc bends between two points with different x."""
        positions, rows = self.layout.positions, self.layout.rows
        inner = [self.layout.routes[arc.source, arc.target] for arc in self.arcs]
        sides: dict[tuple[str, bool], list[tuple[float, int, bool]]] = {}
        for index, (arc, route) in enumerate(zip(self.arcs, inner, strict=True)):
            down = positions[arc.target][1] > positions[arc.source][1]
            follows = route[0] if route else positions[arc.target]
            precedes = route[-1] if route else positions[arc.source]
            sides.setdefault((arc.source, down), []).append((follows[0], index, True))
            sides.setdefault((arc.target, not down), []).append((precedes[0], index, False))
        ends: dict[tuple[int, bool], list[Point]] = {}
        nodes = {node.name: node for node in self.nodes}
        for (name, below), arcs in sides.items():
            (x, y), border = positions[name], rows[name][below]
            offsets = _ports(nodes[name], len(arcs))
            for (_, index, leaves), (dx, dy) in zip(sorted(arcs), offsets, strict=True):
                rim = (x + dx, y + dy if below else y - dy)
                ends[index, leaves] = [rim, (x + dx, border)] if leaves else [(x + dx, border), rim]
        return [[*ends[index, True], *route, *ends[index, False]] for index, route in enumerate(inner)]


def draw(net: Net, *, phases: bool = False, usual: bool = False, subnets: bool = False) -> Drawing:
    """Lay out a net.

    Args:
        net: The net as written; its coordination structures are drawn with it.
        phases: Draw start, active, end and failed of timed transitions; otherwise one box each.
        usual: Leave out what tokens reach only after a failure or a cancellation.
        subnets: Draw the parts of subnets in use; otherwise one box with a double border each.
    """
    nodes, arcs = parts(net, phases=phases, usual=usual, subnets=subnets)
    top = [node.name for node in nodes if node.tokens and node.kind == "place" and node.name != OUTPUT_SEMAPHORE]
    layout = layered({node.name: node.box for node in nodes}, [(arc.source, arc.target) for arc in arcs], top)
    return Drawing(net.name, nodes, arcs, layout)


def path(points: list[Point]) -> str:
    """Return SVG path data: upright lines, and bends with upright ends between the lines."""
    words = [f"M{points[0][0]:.1f} {points[0][1]:.1f}"]
    for (x, y), (u, v) in pairwise(points):
        if abs(x - u) < 0.05:
            words.append(f"V{v:.1f}")
        else:
            middle = (y + v) / 2
            words.append(f"C{x:.1f} {middle:.1f} {u:.1f} {middle:.1f} {u:.1f} {v:.1f}")
    return "".join(words)


def svg(drawing: Drawing) -> str:
    """Return a drawing as an SVG document, with the initial marking."""
    width = drawing.layout.width + 2 * _MARGIN
    height = drawing.layout.height + 2 * _MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.0f}" height="{height:.0f}" '
        f'viewBox="{-_MARGIN:g} {-_MARGIN:g} {width:.0f} {height:.0f}" '
        'font-family="Arial, Liberation Sans, Helvetica, sans-serif" font-size="11">',
        f"<title>{escape(drawing.net)}</title>",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto-start-reverse"><path d="M0 1 8 4 0 7z"/></marker></defs>',
        f'<rect x="{-_MARGIN:g}" y="{-_MARGIN:g}" width="{width:.0f}" height="{height:.0f}" fill="white"/>',
    ]
    for arc, points in zip(drawing.arcs, drawing.points(), strict=True):
        lines.append(_svg_arc(arc, points))
    lines += [_svg_node(node, drawing.layout.positions[node.name]) for node in drawing.nodes]
    return "\n".join([*lines, "</svg>", ""])


def dot(drawing: Drawing) -> str:
    """Return a drawing in the DOT language."""
    lines = [f'digraph "{_quoted(drawing.net)}" {{', "  rankdir=TB; node [fontsize=10];"]
    for node in drawing.nodes:
        shape = "box" if node.kind == "transition" else "circle"
        mark = [str(node.tokens)] if node.tokens else []
        label = "\\n".join(_quoted(line) for line in (node.label, *mark, *node.notes))
        border = " peripheries=2" if node.subnet else ""
        lines.append(f'  "{_quoted(node.name)}" [shape={shape} label="{label}"{border}];')
    styles = {
        "flow": "",
        "failure": " style=dashed",
        "either": " style=bold",
        "inhibitor": " arrowhead=odot",
        "reset": " arrowhead=normalnormal",
    }
    for arc in drawing.arcs:
        weight = f' label="{arc.weight}"' if arc.weight > 1 else ""
        ends = f'"{_quoted(arc.source)}" -> "{_quoted(arc.target)}"'
        lines.append(f"  {ends} [{(styles[arc.kind] + weight).strip()}];")
    return "\n".join([*lines, "}", ""])


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _ports(node: DrawnNode, count: int) -> list[Point]:
    """Return the ends of arcs on the rim of a node, from left to right: offsets from the anchor, downward."""
    radius = {"transition": 0.0, "reference": REFERENCE_RADIUS}.get(node.kind, RADIUS)
    room = 2 * node.box.left - 16 if node.kind == "transition" else 1.3 * radius
    step = min(_PORT, room / (count - 1)) if count > 1 else 0.0
    offsets = [(index - (count - 1) / 2) * step for index in range(count)]
    return [(dx, (radius**2 - dx**2) ** 0.5 if radius else node.box.height / 2) for dx in offsets]


def _svg_arc(arc: DrawnArc, points: list[Point]) -> str:
    style = {
        "flow": 'stroke="#555" marker-end="url(#tip)"',
        "failure": 'stroke="#b33" stroke-dasharray="4 3" marker-end="url(#tip)"',
        "either": 'stroke="#b33" marker-end="url(#tip)"',
        "inhibitor": 'stroke="#555" stroke-dasharray="1 3"',
        "reset": 'stroke="#555" stroke-dasharray="7 2 1 2" marker-end="url(#tip)"',
    }[arc.kind]
    line = f'<path fill="none" {style} d="{path(points)}"/>'
    x, y = points[-1]
    if arc.kind == "inhibitor":
        line += f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="white" stroke="#555"/>'
    if arc.weight > 1:
        beside = y - 6 if points[0][1] < y else y + 14
        line += f'<text x="{x + 5:.1f}" y="{beside:.1f}">{arc.weight}</text>'
    return line


def _svg_node(node: DrawnNode, at: Point) -> str:
    x, y = at
    if node.kind == "transition":
        upper, fill = y - node.box.height / 2, "white" if node.timed else "#dfe8f2"
        top = upper + (18 if node.subnet else 15)
        notes = "".join(
            f'<text x="{x:.1f}" y="{top + LINE * line:.1f}" font-size="9" fill="#456" text-anchor="middle">'
            f"{escape(note)}</text>"
            for line, note in enumerate(node.notes, 1)
        )
        borders = "".join(
            f'<rect x="{x - node.box.left + inward:.1f}" y="{upper + inward:.1f}" '
            f'width="{2 * (node.box.left - inward):.1f}" height="{node.box.height - 2 * inward:g}" rx="2" '
            f'fill="{fill}" stroke="#245"/>'
            for inward in ((0, 3) if node.subnet else (0,))
        )
        return (
            f'<g>{borders}<text x="{x:.1f}" y="{top:.1f}" text-anchor="middle">{escape(node.label)}</text>{notes}</g>'
        )
    radius = REFERENCE_RADIUS if node.kind == "reference" else RADIUS
    dash = "" if node.kind == "place" else ' stroke-dasharray="3 2"'
    mark = "" if not node.tokens else f'<text x="{x:.1f}" y="{y + 4:.1f}" text-anchor="middle">{node.tokens}</text>'
    if node.tokens == 1:
        mark = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{0.4 * radius:.1f}" fill="#111"/>'
    size = ' font-size="9"' if node.kind == "reference" else ""
    notes = "".join(
        f'<text x="{x + radius + 5:.1f}" y="{y + 12:.1f}" font-size="9" fill="#456">{escape(note)}</text>'
        for note in node.notes
    )
    return (
        f'<g><circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" fill="white" stroke="#245"{dash}/>{mark}'
        f'<text x="{x + radius + 4:.1f}" y="{y + (1 if notes else 4):.1f}"{size}>{escape(node.label)}</text>{notes}</g>'
    )
