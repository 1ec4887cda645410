"""Layered layout of a directed graph: layers, few crossings, long edges routed between the nodes.

The method is Sugiyama's (1981): cycles are broken along a depth-first search, layers are longest paths, the order in a
layer is found by barycentres, and the horizontal places by an isotonic fit to the neighbours' means.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

Point = tuple[float, float]
Edge = tuple[str, str]
_Node = str | tuple[int, int]


@dataclass(frozen=True, slots=True)
class Layout:
    """Where things go, in the unit of the given widths; x to the right, y downward.

    Attributes:
        positions: Centre of each node.
        routes: For each edge the points it passes between its two nodes.
        width: Width of the whole.
        height: Height of the whole.
    """

    positions: dict[str, Point]
    routes: dict[Edge, list[Point]]
    width: float
    height: float


@dataclass(slots=True)
class _Layered:
    layers: list[list[_Node]]
    up: dict[_Node, list[_Node]] = field(default_factory=dict)
    down: dict[_Node, list[_Node]] = field(default_factory=dict)
    chains: dict[Edge, list[_Node]] = field(default_factory=dict)


def layered(
    widths: Mapping[str, float],
    edges: Sequence[Edge],
    top: Collection[str] = (),
    row: float = 56.0,
    gap: float = 18.0,
) -> Layout:
    """Lays out a graph from top to bottom.

    Args:
        widths: Width of each node, in the order in which a reader should meet them.
        edges: Pairs of nodes; repeated pairs share a route.
        top: Nodes where the reader begins; edges into them run upward.
        row: Distance between layers.
        gap: Least distance between nodes of a layer.
    """
    if not widths:
        return Layout({}, {}, 0.0, 0.0)
    backward = _backward_edges(list(widths), edges, top)
    graph = _with_dummies(_depths(list(widths), edges, backward), edges, backward)
    _reduce_crossings(graph)
    x = _horizontal(graph, widths, gap)
    spot = {node: (x[node], depth * row) for depth, layer in enumerate(graph.layers) for node in layer}
    left = min(x[node] - widths[node] / 2 for node in x if isinstance(node, str))
    right = max(x[node] + widths[node] / 2 for node in x if isinstance(node, str))
    left, right = min(left, *x.values()), max(right, *x.values())
    spot = {node: (px - left, py) for node, (px, py) in spot.items()}
    routes = {edge: [spot[node] for node in chain] for edge, chain in graph.chains.items()}
    positions = {node: point for node, point in spot.items() if isinstance(node, str)}
    return Layout(positions, routes, right - left, (len(graph.layers) - 1) * row)


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


def _reduce_crossings(graph: _Layered, sweeps: int = 12) -> None:
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


def _horizontal(graph: _Layered, widths: Mapping[str, float], gap: float, sweeps: int = 16) -> dict[_Node, float]:
    def width(node: _Node) -> float:
        return widths[node] if isinstance(node, str) else 4.0

    x: dict[_Node, float] = {}
    offsets: list[list[float]] = []
    for layer in graph.layers:
        right = 0.0
        row: list[float] = []
        for index, node in enumerate(layer):
            right += (width(layer[index - 1]) + width(node)) / 2 + gap if index else 0.0
            row.append(right)
        offsets.append(row)
        for node, place in zip(layer, row, strict=True):
            x[node] = place - right / 2
    for _ in range(sweeps):
        for layer, row in zip(graph.layers, offsets, strict=True):
            wanted: list[float] = []
            for node in layer:
                near = [x[other] for other in (*graph.up.get(node, ()), *graph.down.get(node, ()))]
                wanted.append(sum(near) / len(near) if near else x[node])
            fitted = _isotonic([want - offset for want, offset in zip(wanted, row, strict=True)])
            for node, fit, offset in zip(layer, fitted, row, strict=True):
                x[node] = fit + offset
    return x


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
