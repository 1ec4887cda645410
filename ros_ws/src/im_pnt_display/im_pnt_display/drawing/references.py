"""Arcs ending at a reference, a small copy of a place: too long otherwise, or crowding a place."""

from collections import Counter, deque
from collections.abc import Collection, Sequence

from im_pnt_display.drawing.layout import Edge, backward_edges, connected, depths

_FAILURE_SPAN, _RETURN_SPAN, _JUNCTION, _LAYERS = 3, 6, 4, 18
_ANY_SPAN = 1000
_LARGE, _PIECE, _CANDIDATES = 150, 60, 24
"""A graph with more nodes has no long arc, is drawn in pieces, and fewer ways to go on in another column are tried."""


def far_edges(
    names: list[str], edges: Sequence[Edge], places: Collection[str], top: Collection[str], failures: Collection[Edge]
) -> set[Edge]:
    """Return the edges ending at a reference.

    Args:
        names: Nodes in the order of reading.
        edges: Edges between them.
        places: The nodes that are places; only they have references.
        top: Where the reader begins.
        failures: Edges that are taken on failure, which may be shorter only.
    """
    into = Counter(b for _, b in edges if b in places)
    depth = depths(names, edges, backward_edges(names, edges, top))
    far: set[Edge] = set()
    longest = _ANY_SPAN if len(names) <= _LARGE else _RETURN_SPAN
    for a, b in edges:
        limit = _FAILURE_SPAN if (a, b) in failures else _RETURN_SPAN if b in top else longest
        if abs(depth[a] - depth[b]) > limit or into[b] >= _JUNCTION:
            far.add((a, b))
    rest = [edge for edge in edges if edge not in far]
    waiting = connected(names, rest)
    while waiting:
        part = waiting.pop()
        members = set(part)
        inner = [edge for edge in rest if edge[0] in members] if waiting or len(members) < len(names) else rest
        if cut := _waist(part, inner, places, top):
            far.update(cut)
            waiting += connected(part, [edge for edge in inner if edge not in cut])
            rest = [edge for edge in rest if edge not in cut]
    number = _pieces(names, rest)
    return far | {(a, b) for a, b in rest if number[a] != number[b]}


def _pieces(names: list[str], edges: Sequence[Edge]) -> dict[str, int]:
    """Number the pieces of a graph's drawing: the parts, or neighbourhoods of parts too wide for one."""
    near: dict[str, list[str]] = {name: [] for name in names}
    for a, b in edges:
        near[a].append(b)
        near[b].append(a)
    number: dict[str, int] = {}
    pieces = 0
    for part in connected(names, edges):
        room = len(part) if len(part) <= _LARGE else _PIECE
        for root in part:
            if root in number:
                continue
            pieces += 1
            queue, count = deque([root]), 0
            while queue and count < room:
                node = queue.popleft()
                if node not in number:
                    number[node] = pieces
                    count += 1
                    queue.extend(near[node])
    return number


def _waist(part: list[str], edges: Sequence[Edge], places: Collection[str], top: Collection[str]) -> set[Edge]:
    """Return the edges into the best place for a break of a part too tall for one column."""
    depth = depths(part, edges, backward_edges(part, edges, top))
    height = max(depth.values()) - min(depth.values())
    best: set[Edge] = set()
    if height < _LAYERS:
        return best
    into: dict[str, set[Edge]] = {}
    for edge in edges:
        if edge[1] in places:
            into.setdefault(edge[1], set()).add(edge)
    large = len(part) > _LARGE
    candidates = sorted(into, key=lambda place: abs(2 * depth[place] - height))
    least = height - 3
    for place in candidates[:_CANDIDATES] if large else candidates:
        cut = into[place]
        rest = [edge for edge in edges if edge not in cut]
        pieces = connected(part, rest)
        piece = next(piece for piece in pieces if place in piece)
        if any(a in piece for a, _ in cut):
            continue
        after = depths(part, rest, backward_edges(part, rest, top))
        if (tallest := max(after.values())) < least:
            best, least = cut, tallest
        if large and 3 * least < 2 * height:
            break
    return best
