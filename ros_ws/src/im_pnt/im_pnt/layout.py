"""Layered layout of a directed graph: layers, few crossings, long edges routed between the nodes.

The method is Sugiyama's (1981): cycles are broken along a depth-first search, layers are longest paths, the order in a
layer is found by barycentres, and the horizontal places by an isotonic fit to the neighbours' means. Parts of the graph
that no edge connects are laid out by themselves and set side by side.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

Point = tuple[float, float]
Edge = tuple[str, str]
_Node = str | tuple[int, int]

_ROW_GAP = 24.0
_PART_GAP = 34.0
_ASPECT = 1.5
_DUMMY_WIDTH = 6.0


class Box(NamedTuple):
    """Room that a node needs left and right of its anchor, and its height, centred on the anchor."""

    left: float
    right: float
    height: float


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


@dataclass(slots=True)
class _Layered:
    layers: list[list[_Node]]
    up: dict[_Node, list[_Node]] = field(default_factory=dict)
    down: dict[_Node, list[_Node]] = field(default_factory=dict)
    chains: dict[Edge, list[_Node]] = field(default_factory=dict)


def layered(boxes: Mapping[str, Box], edges: Sequence[Edge], top: Collection[str] = (), gap: float = 16.0) -> Layout:
    """Lays out a graph from top to bottom.

    Args:
        boxes: Room of each node, in the order in which a reader should meet them.
        edges: Pairs of nodes; repeated pairs share a route.
        top: Nodes where the reader begins; edges into them run upward.
        gap: Least distance between nodes of a layer.
    """
    parts = [_connected({node: boxes[node] for node in part}, edges, top, gap) for part in _parts(boxes, edges)]
    return _side_by_side(parts)


def depths(nodes: Sequence[str], edges: Sequence[Edge], top: Collection[str] = ()) -> dict[str, int]:
    """Returns the layer of each node, counted from the top."""
    return _depths(list(nodes), edges, _backward_edges(list(nodes), edges, top))


def _parts(nodes: Collection[str], edges: Sequence[Edge]) -> list[list[str]]:
    """The nodes by connected part; the largest part first."""
    near: dict[str, list[str]] = {node: [] for node in nodes}
    for a, b in edges:
        near[a].append(b)
        near[b].append(a)
    part_of: dict[str, int] = {}
    for number, root in enumerate(nodes):
        stack = [root]
        while stack:
            node = stack.pop()
            if node not in part_of:
                part_of[node] = number
                stack.extend(near[node])
    parts: dict[int, list[str]] = {}
    for node in nodes:
        parts.setdefault(part_of[node], []).append(node)
    return sorted(parts.values(), key=len, reverse=True)


def _side_by_side(parts: list[Layout]) -> Layout:
    """Sets parts in shelves whose whole is near the aspect of a screen."""
    area = sum((part.width + _PART_GAP) * (part.height + _PART_GAP) for part in parts)
    limit = max([(area * _ASPECT) ** 0.5, *(part.width for part in parts)])
    whole = Layout({}, {}, {}, 0.0, 0.0)
    x = y = shelf = width = 0.0
    for part in parts:
        if x and x + part.width > limit:
            x, y, shelf = 0.0, y + shelf + _PART_GAP, 0.0
        whole.positions.update({node: (px + x, py + y) for node, (px, py) in part.positions.items()})
        whole.rows.update({node: (upper + y, lower + y) for node, (upper, lower) in part.rows.items()})
        whole.routes.update({edge: [(px + x, py + y) for px, py in route] for edge, route in part.routes.items()})
        width, shelf = max(width, x + part.width), max(shelf, part.height)
        x += part.width + _PART_GAP
    return Layout(whole.positions, whole.rows, whole.routes, width, y + shelf)


def _connected(boxes: Mapping[str, Box], every: Sequence[Edge], top: Collection[str], gap: float) -> Layout:
    edges = [edge for edge in every if edge[0] in boxes]
    backward = _backward_edges(list(boxes), edges, top)
    graph = _with_dummies(_depths(list(boxes), edges, backward), edges, backward)
    _reduce_crossings(graph)
    x = _horizontal(graph, boxes, gap)
    left = min(x[node] - _box(boxes, node).left for node in x)
    width = max(x[node] + _box(boxes, node).right for node in x) - left
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


def _rows(graph: _Layered, boxes: Mapping[str, Box], x: Mapping[_Node, float]) -> list[tuple[float, float]]:
    """Borders of the layers; the steeper the edges between two of them would lie, the wider the gap."""
    rows: list[tuple[float, float]] = []
    at = 0.0
    for layer in graph.layers:
        height = max(_box(boxes, node).height for node in layer)
        sideways = max((abs(x[node] - x[above]) for node in layer for above in graph.up.get(node, ())), default=0.0)
        at += _ROW_GAP + min(24.0, 0.08 * sideways) if rows else 0.0
        rows.append((at, at + height))
        at += height
    return rows


def _box(boxes: Mapping[str, Box], node: _Node) -> Box:
    return boxes[node] if isinstance(node, str) else Box(_DUMMY_WIDTH / 2, _DUMMY_WIDTH / 2, 0.0)


def _backward_edges(nodes: list[str], edges: Sequence[Edge], top: Collection[str]) -> set[Edge]:
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


def _depths(nodes: list[str], edges: Sequence[Edge], backward: set[Edge]) -> dict[str, int]:
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
    sources = [node for node in nodes if follows[node] and not any(b == node for _, b in forward)]
    for node in sources:
        depth[node] = min(depth[after] for after in follows[node]) - 1
    return depth


def _with_dummies(depth: dict[str, int], edges: Sequence[Edge], backward: set[Edge]) -> _Layered:
    graph = _Layered([[] for _ in range(max(depth.values()) + 1)])
    for node, level in depth.items():
        graph.layers[level].append(node)
    serial = 0
    made: dict[Edge, list[_Node]] = {}
    for edge in dict.fromkeys(edges):
        a, b = _forward(edge, backward)
        if (a, b) not in made:
            chain: list[_Node] = []
            for level in range(depth[a] + 1, depth[b]):
                dummy = (serial, level)
                serial += 1
                graph.layers[level].append(dummy)
                chain.append(dummy)
            made[a, b] = chain
            full: list[_Node] = [a, *chain, b]
            for upper, lower in pairwise(full):
                graph.down.setdefault(upper, []).append(lower)
                graph.up.setdefault(lower, []).append(upper)
        graph.chains[edge] = made[a, b][::-1] if edge in backward else made[a, b]
    return graph


def _reduce_crossings(graph: _Layered, sweeps: int = 16) -> None:
    best, fewest = [list(layer) for layer in graph.layers], _crossings(graph)
    for sweep in range(sweeps):
        downward = sweep % 2 == 0
        neighbours = graph.up if downward else graph.down
        levels = range(1, len(graph.layers)) if downward else range(len(graph.layers) - 2, -1, -1)
        for level in levels:
            other = graph.layers[level - 1 if downward else level + 1]
            place = {node: index for index, node in enumerate(other)}
            centres: dict[_Node, float] = {}
            for index, node in enumerate(graph.layers[level]):
                near = [place[neighbour] for neighbour in neighbours.get(node, ())]
                centres[node] = sum(near) / len(near) if near else float(index)
            graph.layers[level].sort(key=centres.__getitem__)
        crossings = _crossings(graph)
        if crossings < fewest:
            best, fewest = [list(layer) for layer in graph.layers], crossings
    graph.layers[:] = best


def _crossings(graph: _Layered) -> int:
    count = 0
    for upper, lower in pairwise(graph.layers):
        place = {node: index for index, node in enumerate(lower)}
        ends = [sorted(place[below] for below in graph.down.get(node, ())) for node in upper]
        flat = [end for group in ends for end in group]
        count += sum(left > right for index, left in enumerate(flat) for right in flat[index + 1 :])
    return count


def _horizontal(graph: _Layered, boxes: Mapping[str, Box], gap: float, sweeps: int = 24) -> dict[_Node, float]:
    x: dict[_Node, float] = {}
    offsets: list[list[float]] = []
    for layer in graph.layers:
        right = 0.0
        row: list[float] = []
        for index, node in enumerate(layer):
            right += _box(boxes, layer[index - 1]).right + _box(boxes, node).left + gap if index else 0.0
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
    return x


def _wanted(graph: _Layered, x: Mapping[_Node, float], node: _Node) -> float:
    """Mean of the neighbours; the dummies of a long edge follow each other, which keeps it straight."""
    near = [*graph.up.get(node, ()), *graph.down.get(node, ())]
    if not isinstance(node, str):
        near = [other for other in near if not isinstance(other, str)] or near
    return sum(x[other] for other in near) / len(near) if near else x[node]


def _isotonic(values: list[float]) -> list[float]:
    """Returns the non-decreasing sequence nearest to the values (pool adjacent violators)."""
    blocks: list[tuple[float, int]] = []
    for value in values:
        total, count = value, 1
        while blocks and blocks[-1][0] / blocks[-1][1] > total / count:
            earlier, size = blocks.pop()
            total, count = total + earlier, count + size
        blocks.append((total, count))
    return [total / count for total, count in blocks for _ in range(count)]
