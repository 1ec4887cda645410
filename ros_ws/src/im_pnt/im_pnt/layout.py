"""Layout of a directed graph from top to bottom: connected parts in layers, and the parts side by side."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from im_pnt.layers import (
    Box,
    Edge,
    Layered,
    Node,
    backward_edges,
    box_of,
    connected,
    depths,
    horizontal,
    reduce_crossings,
    with_dummies,
)

Point = tuple[float, float]

_ROW_GAP = 12.0
_APPROACH = 7.0
_PART_GAP = 34.0
_ASPECT = 1.3


@dataclass(frozen=True, slots=True)
class Layout:
    """Where things go, in the unit of the given boxes; x to the right, y downward.

    Attributes:
        positions: Anchor of each node.
        rows: Upper and lower border of the row that each node is in; edges cross rows upright only.
        routes: For each edge the points it passes between the rows of its two nodes.
        width: Width of the whole.
        height: Height of the whole.
    """

    positions: dict[str, Point]
    rows: dict[str, tuple[float, float]]
    routes: dict[Edge, list[Point]]
    width: float
    height: float


def layered(boxes: Mapping[str, Box], edges: Sequence[Edge], top: Collection[str] = (), gap: float = 16.0) -> Layout:
    """Lays out a graph from top to bottom.

    Args:
        boxes: Room of each node, in the order in which a reader should meet them.
        edges: Pairs of nodes; repeated pairs share a route.
        top: Nodes where the reader begins; edges into them run upward.
        gap: Least distance between nodes of a layer.
    """
    parts = [_connected({node: boxes[node] for node in part}, edges, top, gap) for part in connected(boxes, edges)]
    return _side_by_side(parts)


def _side_by_side(parts: list[Layout]) -> Layout:
    """Sets parts in columns whose whole is near the aspect of a screen."""
    area = sum((part.width + _PART_GAP) * (part.height + _PART_GAP) for part in parts)
    tallest = max([(area / _ASPECT) ** 0.5, *(part.height for part in parts)])
    whole = Layout({}, {}, {}, 0.0, 0.0)
    columns: list[tuple[float, float, float]] = []
    for part in parts:
        for index, (x, y, width) in enumerate(columns):
            last = index == len(columns) - 1
            if y + part.height <= tallest and (last or part.width <= width):
                columns[index] = (x, y + part.height + _PART_GAP, max(width, part.width))
                break
        else:
            x, y = (columns[-1][0] + columns[-1][2] + _PART_GAP, 0.0) if columns else (0.0, 0.0)
            columns.append((x, part.height + _PART_GAP, part.width))
        whole.positions.update({node: (px + x, py + y) for node, (px, py) in part.positions.items()})
        whole.rows.update({node: (upper + y, lower + y) for node, (upper, lower) in part.rows.items()})
        whole.routes.update({edge: [(px + x, py + y) for px, py in route] for edge, route in part.routes.items()})
    width = max((x + width for x, _, width in columns), default=0.0)
    height = max((y for _, y, _ in columns), default=_PART_GAP) - _PART_GAP
    return Layout(whole.positions, whole.rows, whole.routes, width, height)


def _connected(boxes: Mapping[str, Box], every: Sequence[Edge], top: Collection[str], gap: float) -> Layout:
    edges = [edge for edge in every if edge[0] in boxes]
    backward = backward_edges(list(boxes), edges, top)
    graph = with_dummies(depths(list(boxes), edges, backward), edges, backward)
    reduce_crossings(graph)
    x = horizontal(graph, boxes, gap)
    left = min(x[node] - box_of(boxes, node).left for node in x)
    width = max(x[node] + box_of(boxes, node).right for node in x) - left
    rows = _rows(graph, boxes, x)
    positions: dict[str, Point] = {}
    borders: dict[str, tuple[float, float]] = {}
    for layer, (upper, lower) in zip(graph.layers, rows, strict=True):
        for node in layer:
            if isinstance(node, str):
                positions[node] = (x[node] - left, (upper + lower) / 2)
                borders[node] = (upper, lower)
    routes: dict[Edge, list[Point]] = {}
    for (a, b), chain in graph.chains.items():
        upward = positions[a][1] > positions[b][1]
        routes[a, b] = [
            (x[node] - left, border)
            for node in chain
            if not isinstance(node, str)
            for border in (rows[node[1]][::-1] if upward else rows[node[1]])
        ]
    return Layout(positions, borders, routes, width, rows[-1][1])


def _rows(graph: Layered, boxes: Mapping[str, Box], x: Mapping[Node, float]) -> list[tuple[float, float]]:
    """Borders of the layers; the farther edges go sideways between two of them, the wider the gap."""
    rows: list[tuple[float, float]] = []
    at = 0.0
    for layer in graph.layers:
        height = max(box_of(boxes, node).height for node in layer) + 2 * _APPROACH
        sideways = max((abs(x[node] - x[above]) for node in layer for above in graph.up.get(node, ())), default=0.0)
        at += _ROW_GAP + min(24.0, 0.08 * sideways) if rows else 0.0
        rows.append((at, at + height))
        at += height
    return rows
