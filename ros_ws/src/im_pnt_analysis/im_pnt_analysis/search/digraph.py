"""Strongly connected components, and reachability, in directed graphs given by rows of arcs.

Small graphs are done in plain Python, since importing scipy would take longer than the work; large ones by scipy.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Begins = npt.NDArray[np.int64]
"""Where the arcs of each node begin, and at the end their number; shape (nodes + 1,)."""

Targets = npt.NDArray[np.int32]
"""Where each arc leads, shape (arcs,)."""

Mask = npt.NDArray[np.bool_]
"""For each node whether it belongs to a set, shape (nodes,)."""

_SMALL = 60_000
_CHUNK = 1 << 20


@dataclass(frozen=True, slots=True)
class Components:
    """Strongly connected components.

    Attributes:
        count: Their number.
        label: For each node its component, shape (nodes,).
        terminal: For each component whether no arc leaves it, shape (components,).
    """

    count: int
    label: npt.NDArray[np.int32]
    terminal: Mask


def components(begins: Begins, targets: Targets) -> Components:
    """Return the strongly connected components of a graph.

    Args:
        begins: Where the arcs of each node begin.
        targets: Where each arc leads; no arc may be there twice (scipy would not return).
    """
    nodes = len(begins) - 1
    if nodes + len(targets) <= _SMALL:
        count, label = _tarjan(begins.tolist(), targets.tolist())
    else:
        from scipy.sparse import csr_array
        from scipy.sparse.csgraph import connected_components

        matrix = csr_array((np.ones(len(targets)), targets, begins.astype(np.int32)), shape=(nodes, nodes))
        count, label = connected_components(matrix, connection="strong")
    terminal = np.ones(count, bool)
    if count > 1:
        for first in range(0, nodes, _CHUNK):
            last = min(nodes, first + _CHUNK)
            sources = np.repeat(label[first:last], np.diff(begins[first : last + 1]))
            leaving = sources != label[targets[begins[first] : begins[last]]]
            terminal[sources[leaving]] = False
    return Components(count, label, terminal)


def _tarjan(begins: Sequence[int], targets: Sequence[int]) -> tuple[int, npt.NDArray[np.int32]]:
    """Tarjan's algorithm (1972) without recursion."""
    nodes = len(begins) - 1
    label, order, low = [-1] * nodes, [-1] * nodes, [0] * nodes
    count = clock = 0
    open_nodes: list[int] = []
    for root in range(nodes):
        if order[root] >= 0:
            continue
        path = [(root, begins[root])]
        order[root] = low[root] = clock
        clock += 1
        open_nodes.append(root)
        while path:
            node, arc = path.pop()
            lowest = low[node]
            end = begins[node + 1]
            while arc < end:
                after = targets[arc]
                if order[after] < 0:
                    break
                if label[after] < 0 and order[after] < lowest:
                    lowest = order[after]
                arc += 1
            low[node] = lowest
            if arc < end:
                path.append((node, arc + 1))  # come back behind this arc
                after = targets[arc]
                order[after] = low[after] = clock
                clock += 1
                open_nodes.append(after)
                path.append((after, begins[after]))
                continue
            if lowest == order[node]:  # nothing earlier is reached: the component is complete
                member = -1
                while member != node:
                    member = open_nodes.pop()
                    label[member] = count
                count += 1
            if path:
                parent = path[-1][0]
                low[parent] = min(low[parent], lowest)
    return count, np.array(label, np.int32)


def reaching(begins: Begins, targets: Targets, goal: Mask) -> Mask:
    """Return the nodes with a path to a node of a set, including the set."""
    nodes = len(begins) - 1
    sources = np.repeat(np.arange(nodes, dtype=np.int32), np.diff(begins))
    if nodes + len(targets) <= _SMALL:
        before: list[list[int]] = [[] for _ in range(nodes)]
        for source, target in zip(sources.tolist(), targets.tolist(), strict=True):
            before[target].append(source)
        return _closure(before, np.flatnonzero(goal).tolist())
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order

    wanted = np.flatnonzero(goal).astype(np.int32)
    start = np.full(len(wanted), nodes, np.int32)
    rows, columns = np.concatenate((targets, start)), np.concatenate((sources, wanted))
    backward = coo_array((np.ones(len(rows)), (rows, columns)), shape=(nodes + 1, nodes + 1)).tocsr()
    reached = breadth_first_order(backward, nodes, directed=True, return_predecessors=False)
    result = np.zeros(nodes + 1, bool)
    result[reached] = True
    return result[:nodes]


def _closure(before: Sequence[Sequence[int]], goal: Iterable[int]) -> Mask:
    result = np.zeros(len(before), bool)
    stack = list(goal)
    result[stack] = True
    while stack:
        for earlier in before[stack.pop()]:
            if not result[earlier]:
                result[earlier] = True
                stack.append(earlier)
    return result
