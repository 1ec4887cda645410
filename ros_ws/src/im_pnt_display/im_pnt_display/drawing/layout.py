"""Layout of a directed graph from top to bottom, after Sugiyama (1981): parts in layers, and the parts side by side.

Cycles are broken along a depth-first search, layers are longest paths, the order in a layer is found by barycentres,
and the horizontal places by an isotonic fit to the neighbours' means.
"""

from bisect import bisect_right, insort
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

Edge = tuple[str, str]
Node = str | tuple[int, int]
"""A node of the graph, or a dummy where an edge crosses a layer: its number and that layer."""

_DUMMY_WIDTH = 6.0


class NodeBox(NamedTuple):
    """Room of a node left and right of the anchor, and the height, centred on the anchor."""

    left: float
    right: float
    height: float


@dataclass(slots=True)
class Layered:
    """Layers of nodes and dummies, the neighbours above and below, and the dummies of each edge."""

    layers: list[list[Node]]
    up: dict[Node, list[Node]] = field(default_factory=dict)
    down: dict[Node, list[Node]] = field(default_factory=dict)
    chains: dict[Edge, list[Node]] = field(default_factory=dict)


def box_of(boxes: Mapping[str, NodeBox], node: Node) -> NodeBox:
    """Return the room of a node or dummy."""
    return boxes[node] if isinstance(node, str) else NodeBox(_DUMMY_WIDTH / 2, _DUMMY_WIDTH / 2, 0.0)


def connected(nodes: Collection[str], edges: Sequence[Edge]) -> list[list[str]]:
    """Return the nodes of each connected part, the largest part first; nodes without edges make one part."""
    near: dict[str, list[str]] = {node: [] for node in nodes}
    for a, b in edges:
        near[a].append(b)
        near[b].append(a)
    part_of: dict[str, int] = {}
    for number, root in enumerate(nodes):
        stack = [root] if near[root] else []
        while stack:
            node = stack.pop()
            if node not in part_of:
                part_of[node] = number
                stack.extend(near[node])
    parts: dict[int, list[str]] = {}
    for node in nodes:
        parts.setdefault(part_of.get(node, -1), []).append(node)
    return sorted(parts.values(), key=len, reverse=True)


def backward_edges(nodes: list[str], edges: Sequence[Edge], top: Collection[str]) -> set[Edge]:
    """Return edges of all cycles, including edges into ``top``: without the returned edges there is no cycle."""
    follows: dict[str, list[str]] = {node: [] for node in nodes}
    backward = {(a, b) for a, b in edges if b in top}
    for a, b in edges:
        if b not in top:
            follows[a].append(b)
    state: dict[str, int] = {}
    for root in nodes:
        stack = [(root, iter(follows[root]))] if root not in state else []
        state.setdefault(root, 1)
        while stack:
            node, children = stack[-1]
            child = next(children, None)
            if child is None:
                state[node] = 2
                stack.pop()
            elif state.get(child) == 1:
                backward.add((node, child))
            elif child not in state:
                state[child] = 1
                stack.append((child, iter(follows[child])))
    return backward


def _forward(edge: Edge, backward: set[Edge]) -> Edge:
    return (edge[1], edge[0]) if edge in backward else edge


def depths(nodes: list[str], edges: Sequence[Edge], backward: set[Edge]) -> dict[str, int]:
    """Return the layer of each node, counted from the top; edges of ``backward`` run upward."""
    forward = {_forward(edge, backward) for edge in edges if edge[0] != edge[1]}
    waiting = dict.fromkeys(nodes, 0)
    follows: dict[str, list[str]] = {node: [] for node in nodes}
    for a, b in sorted(forward):
        waiting[b] += 1
        follows[a].append(b)
    depth = dict.fromkeys(nodes, 0)
    ready = [node for node in nodes if waiting[node] == 0]
    while ready:
        node = ready.pop()
        for after in follows[node]:
            depth[after] = max(depth[after], depth[node] + 1)
            waiting[after] -= 1
            if waiting[after] == 0:
                ready.append(after)
    targets = {b for _, b in forward}
    sources = [node for node in nodes if follows[node] and node not in targets]
    for node in sources:
        depth[node] = min(depth[after] for after in follows[node]) - 1
    return depth


def with_dummies(depth: dict[str, int], edges: Sequence[Edge], backward: set[Edge]) -> Layered:
    """Return the layers, with a dummy for each crossed layer of an edge."""
    graph = Layered([[] for _ in range(max(depth.values()) + 1)])
    for node, level in depth.items():
        graph.layers[level].append(node)
    serial = 0
    made: dict[Edge, list[Node]] = {}
    for edge in dict.fromkeys(edges):
        a, b = _forward(edge, backward)
        if (a, b) not in made:
            chain: list[Node] = []
            for level in range(depth[a] + 1, depth[b]):
                dummy = (serial, level)
                serial += 1
                graph.layers[level].append(dummy)
                chain.append(dummy)
            made[a, b] = chain
            full: list[Node] = [a, *chain, b]
            for upper, lower in pairwise(full):
                graph.down.setdefault(upper, []).append(lower)
                graph.up.setdefault(lower, []).append(upper)
        graph.chains[edge] = made[a, b][::-1] if edge in backward else made[a, b]
    return graph


def reduce_crossings(graph: Layered, sweeps: int = 16) -> None:
    """Order each layer by barycentres; the best order seen stays."""
    best, fewest = [list(layer) for layer in graph.layers], _crossings(graph)
    for sweep in range(sweeps):
        downward = sweep % 2 == 0
        neighbours = graph.up if downward else graph.down
        levels = range(1, len(graph.layers)) if downward else range(len(graph.layers) - 2, -1, -1)
        for level in levels:
            other = graph.layers[level - 1 if downward else level + 1]
            place = {node: index for index, node in enumerate(other)}
            centres: dict[Node, float] = {}
            for index, node in enumerate(graph.layers[level]):
                near = [place[neighbour] for neighbour in neighbours.get(node, ())]
                centres[node] = sum(near) / len(near) if near else float(index)
            graph.layers[level].sort(key=centres.__getitem__)
        crossings = _crossings(graph)
        if crossings < fewest:
            best, fewest = [list(layer) for layer in graph.layers], crossings
    graph.layers[:] = best


def _crossings(graph: Layered) -> int:
    count = 0
    for upper, lower in pairwise(graph.layers):
        place = {node: index for index, node in enumerate(lower)}
        seen: list[int] = []
        for node in upper:
            ends = [place[below] for below in graph.down.get(node, ())]
            count += sum(len(seen) - bisect_right(seen, end) for end in ends)
            for end in ends:
                insort(seen, end)
    return count


def horizontal(graph: Layered, boxes: Mapping[str, NodeBox], gap: float, sweeps: int = 24) -> dict[Node, float]:
    """Return the horizontal place of every node and dummy."""
    x: dict[Node, float] = {}
    offsets: list[list[float]] = []
    for layer in graph.layers:
        right = 0.0
        row: list[float] = []
        for index, node in enumerate(layer):
            right += box_of(boxes, layer[index - 1]).right + box_of(boxes, node).left + gap if index else 0.0
            row.append(right)
        offsets.append(row)
        for node, place in zip(layer, row, strict=True):
            x[node] = place - right / 2
    for sweep in range(sweeps):
        order = list(zip(graph.layers, offsets, strict=True))
        for layer, row in order if sweep % 2 == 0 else order[::-1]:
            wanted = [_wanted(graph, x, node) for node in layer]
            fitted = _isotonic([want - offset for want, offset in zip(wanted, row, strict=True)])
            for node, fit, offset in zip(layer, fitted, row, strict=True):
                x[node] = fit + offset
    _straighten(graph, boxes, x, gap)
    return x


def _wanted(graph: Layered, x: Mapping[Node, float], node: Node) -> float:
    """Return the mean of the neighbours; the dummies of a long edge follow each other, for a straight line."""
    near = [*graph.up.get(node, ()), *graph.down.get(node, ())]
    if not isinstance(node, str):
        near = [other for other in near if not isinstance(other, str)] or near
    return sum(x[other] for other in near) / len(near) if near else x[node]


def _straighten(graph: Layered, boxes: Mapping[str, NodeBox], x: dict[Node, float], gap: float) -> None:
    """Make a long edge upright over the whole length where there is room."""
    room: dict[Node, tuple[Node | None, Node | None]] = {}
    for layer in graph.layers:
        for before, node, after in zip([None, *layer], layer, [*layer[1:], None], strict=False):
            room[node] = (before, after)
    for chain in {id(chain): chain for chain in graph.chains.values() if len(chain) > 1}.values():
        lower, upper = float("-inf"), float("inf")
        for node in chain:
            before, after = room[node]
            half = box_of(boxes, node).left + gap
            lower = lower if before is None else max(lower, x[before] + box_of(boxes, before).right + half)
            upper = upper if after is None else min(upper, x[after] - box_of(boxes, after).left - half)
        if lower <= upper:
            mean = sum(x[node] for node in chain) / len(chain)
            x.update(dict.fromkeys(chain, min(max(mean, lower), upper)))


def _isotonic(values: list[float]) -> list[float]:
    """Return the non-decreasing sequence nearest to the values (pool adjacent violators)."""
    blocks: list[tuple[float, int]] = []
    for value in values:
        total, count = value, 1
        while blocks and blocks[-1][0] / blocks[-1][1] > total / count:
            earlier, size = blocks.pop()
            total, count = total + earlier, count + size
        blocks.append((total, count))
    return [total / count for total, count in blocks for _ in range(count)]


Point = tuple[float, float]

_ROW_GAP = 12.0
_APPROACH = 7.0
_PART_GAP = 34.0
_ASPECT = 1.3


@dataclass(frozen=True, slots=True)
class GraphLayout:
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


def layered(
    boxes: Mapping[str, NodeBox], edges: Sequence[Edge], top: Collection[str] = (), gap: float = 16.0
) -> GraphLayout:
    """Lay out a graph from top to bottom.

    Args:
        boxes: Room of each node, in the order in which a reader should meet them.
        edges: Pairs of nodes; repeated pairs share a route.
        top: Nodes where the reader begins; edges into them run upward.
        gap: Least distance between nodes of a layer.
    """
    parts = [_connected({node: boxes[node] for node in part}, edges, top, gap) for part in connected(boxes, edges)]
    return _side_by_side(parts)


def _side_by_side(parts: list[GraphLayout]) -> GraphLayout:
    """Set parts in columns with a total near the aspect of a screen."""
    area = sum((part.width + _PART_GAP) * (part.height + _PART_GAP) for part in parts)
    tallest = max([(area / _ASPECT) ** 0.5, *(part.height for part in parts)])
    whole = GraphLayout({}, {}, {}, 0.0, 0.0)
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
    return GraphLayout(whole.positions, whole.rows, whole.routes, width, height)


def _connected(boxes: Mapping[str, NodeBox], every: Sequence[Edge], top: Collection[str], gap: float) -> GraphLayout:
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
    return GraphLayout(positions, borders, routes, width, rows[-1][1])


def _rows(graph: Layered, boxes: Mapping[str, NodeBox], x: Mapping[Node, float]) -> list[tuple[float, float]]:
    """Return the borders of the layers; the farther edges go sideways between two layers, the wider the gap."""
    rows: list[tuple[float, float]] = []
    at = 0.0
    for layer in graph.layers:
        height = max(box_of(boxes, node).height for node in layer) + 2 * _APPROACH
        sideways = max((abs(x[node] - x[above]) for node in layer for above in graph.up.get(node, ())), default=0.0)
        at += _ROW_GAP + min(24.0, 0.08 * sideways) if rows else 0.0
        rows.append((at, at + height))
        at += height
    return rows
