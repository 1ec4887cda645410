"""``python -m bench.mcs.drawing FOLDER``: the paper's Figures 6 and 7, redrawn from what the code says."""

import sys
from html import escape
from pathlib import Path

from im_mcs.state.table import TABLE, State, lifecycle_of

LAYERS = (
    ("client interface", "im_mcs/client, im_mcs/ros", "/<group>/path", "actions, services, /<group>/joint_trajectory"),
    ("motion planning", "im_mcs/planning", "/<group>/setpoints", "/<group>/command/setpoints"),
    ("motion control", "im_mcs/control", "/<group>/torques", "/<group>/command/torques"),
    ("testbed interface", "im_mcs/testbed", "/mcs/slots, /<wrist>/wrench", "channel drivers"),
)
"""From the top: name, where it is, the topic that shows it, and what drives it."""

_BESIDE = (("state manager", "im_mcs/state"), ("safety", "im_mcs/safety"), ("collision", "im_mcs/collision"))
_PLACES = {
    State.UNCONFIGURED: (110, 60),
    State.COLD: (110, 200),
    State.RESERVED: (460, 200),
    State.ACTIVE: (810, 200),
    State.MOTION: (810, 420),
    State.ESTOPPED: (330, 420),
}
_WIDTH, _HEIGHT = 150, 54
_STYLE = (
    "text{font:13px sans-serif;text-anchor:middle}.s{font-size:11px;fill:#555}"
    ".e{font-size:11px;fill:#0a4a8a;paint-order:stroke;stroke:#fff;stroke-width:4px}"
    "rect{fill:#f4f6f8;stroke:#333}path{fill:none;stroke:#333}"
)
_ARROW = (
    '<marker id="a" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0 0 8 4 0 8z" style="fill:#333"/></marker>'
)


def figure_6() -> str:
    """The layers of MCS, each with the topic that shows it and the one that drives it, as SVG."""
    parts = []
    for row, (name, place, shows, drives) in enumerate(LAYERS):
        y = 40 + 90 * row
        parts += [_box(410, y + 25, 260, 50, name, place)]
        parts += [_text(140, y + 20, drives, "e"), _text(140, y + 34, "drives", "s")]
        parts += [_text(650, y + 20, shows, "e"), _text(650, y + 34, "shows", "s")]
        if row:
            parts.append(f'<path d="M395 {y - 40}V{y}" marker-end="url(#a)"/>')
            parts.append(f'<path d="M425 {y}V{y - 40}" marker-end="url(#a)"/>')
    for row, (name, place) in enumerate(_BESIDE):
        parts.append(_box(890, 80 + 110 * row, 170, 60, name, place))
    parts.append('<path d="M780 40V370" stroke-dasharray="4 4"/>')
    return _svg(1000, 410, parts)


def figure_7() -> str:
    """States of a group, and the events that lead from one to another; below, what leaves each as it is."""
    ways: dict[tuple[State, State], list[str]] = {}
    stays: dict[State, list[str]] = {}
    for row in TABLE:
        if row.source is row.target:
            stays.setdefault(row.source, []).append(row.event.value)
        else:
            ways.setdefault((row.source, row.target), []).append(row.event.value)
    parts = [_way(source, target, events, (target, source) in ways) for (source, target), events in ways.items()]
    for state, (x, y) in _PLACES.items():
        parts.append(_box(x, y, _WIDTH, _HEIGHT, state.value, f"lifecycle {lifecycle_of(state)}"))
    legend = [f"{state.value} stays: {', '.join(events)}" for state, events in stays.items()]
    parts.append(_text(560, 40, "of each group; the state of MCS is the highest that any group is in", "s"))
    parts += [_text(470, 520 + 20 * row, line, "s") for row, line in enumerate(legend)]
    return _svg(940, 540 + 20 * len(legend), parts)


def _way(source: State, target: State, events: list[str], both: bool) -> str:
    """An arrow with its events; two that run against each other keep apart."""
    (x0, y0), (x1, y1) = _PLACES[source], _PLACES[target]
    dx, dy = x1 - x0, y1 - y0
    length = (dx * dx + dy * dy) ** 0.5
    nx, ny = -dy / length, dx / length
    shift = 12.0 if both else 0.0
    share = min(_WIDTH / 2 / abs(dx) if dx else 9.0, _HEIGHT / 2 / abs(dy) if dy else 9.0)
    ax, ay = x0 + share * dx + shift * nx, y0 + share * dy + shift * ny
    bx, by = x1 - share * dx + shift * nx, y1 - share * dy + shift * ny
    words = ", ".join(events)
    tx = (ax + bx) / 2 + (shift and shift - 4 + 3.2 * len(words)) * nx
    ty = (ay + by) / 2 + shift * ny
    arrow = f'<path d="M{ax:.0f} {ay:.0f}L{bx:.0f} {by:.0f}" marker-end="url(#a)"/>'
    return arrow + _text(round(tx), round(ty) + 4, words, "e")


def _box(x: int, y: int, width: int, height: int, name: str, below: str) -> str:
    rectangle = f'<rect x="{x - width // 2}" y="{y - height // 2}" width="{width}" height="{height}" rx="6"/>'
    return rectangle + _text(x, y - 2, name) + _text(x, y + 15, below, "s")


def _text(x: int, y: int, words: str, kind: str = "") -> str:
    chosen = f' class="{kind}"' if kind else ""
    return f'<text x="{x}" y="{y}"{chosen}>{escape(words)}</text>'


def _svg(width: int, height: int, parts: list[str]) -> str:
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}">'
    ground = f'<rect width="{width}" height="{height}" style="fill:#fff;stroke:none"/>'
    return "\n".join([head, f"<style>{_STYLE}</style><defs>{_ARROW}</defs>", ground, *parts, "</svg>\n"])


FIGURES = {"mcs_layers.svg": figure_6, "mcs_states.svg": figure_7}


def main(folder: Path) -> None:
    """Write the figures into a folder."""
    for name, figure in FIGURES.items():
        (folder / name).write_text(figure(), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
