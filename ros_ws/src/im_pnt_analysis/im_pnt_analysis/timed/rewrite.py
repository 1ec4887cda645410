"""Estimates in the text of a net file; everything else stays as the author wrote the file."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain

import yaml

from im_pnt.model.delay import Delay
from im_pnt.model.net import Net
from im_pnt_analysis.timed.measurement import TransitionEstimate


@dataclass(frozen=True, slots=True)
class Rewritten:
    """A text with new values.

    Attributes:
        text: The text.
        changed: How many values are new.
        elsewhere: Transitions that are not written in the text as they are: templates or ``tries`` make them, or what
            is written in one place is used in several, as anchors do.
    """

    text: str
    changed: int
    elsewhere: tuple[str, ...]


def rewrite(text: str, net: Net, found: Mapping[str, TransitionEstimate]) -> Rewritten:
    """Put estimates into the transitions of a net file: the ``delay``, ``success`` and ``weight``.

    Comments, order and layout stay. A value that was not measured stays; a delay of several lines becomes one of one.
    """
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    assert isinstance(root, yaml.MappingNode)
    written = _pairs(_pairs(root).get("transitions", (None, None))[1])
    edits: list[tuple[int, int, str]] = []
    elsewhere = []
    shared = _shared(root)
    for name, each in found.items():
        values = _values(each, net, name)
        node = written[name][1] if name in written else None
        keys = _pairs(node)
        used = {id(node), *(id(keys[key][1]) for key in values if key in keys)}
        if not isinstance(node, yaml.MappingNode) or not node.value or used & shared:
            elsewhere += [name] if values else []
            continue
        added = []
        for key, (value, usual) in values.items():
            if key not in keys:
                added += [] if usual else [f"{key}: {value}"]
                continue
            begin, end = keys[key][0].end_mark.index, _end(text, keys[key][1])
            if text[begin:end] != f": {value}":
                edits.append((begin, end, f": {value}"))
        if added:
            edits.append(_insertion(text, node, added))
    for begin, end, new in sorted(edits, reverse=True):  # from the end: earlier positions stay right
        text = text[:begin] + new + text[end:]
    return Rewritten(text, len(edits), tuple(elsewhere))


def _values(each: TransitionEstimate, net: Net, name: str) -> dict[str, tuple[str, bool]]:
    """Return the text of each value, and whether the transition is silent on the value."""
    values: dict[str, tuple[str, bool]] = {}
    if each.delay is not None:
        values["delay"] = (delay_text(each.delay.delay), each.delay.delay is None)
    if each.success is not None:
        values["success"] = (_number(each.success[0]), each.success[0] == 1.0)
    if each.weight is not None and each.weight != net.transitions[name].weight:
        values["weight"] = (_number(each.weight), False)
    return values


def delay_text(delay: Delay | None) -> str:
    """Return a delay in the form of net files, in one line."""
    if delay is None or delay.kind == "constant":
        return _number(0.0 if delay is None else delay.values[0])
    return f"{{{delay.kind}: {{{', '.join(f'{key}: {_number(value)}' for key, value in delay.parameters().items())}}}}}"


def _number(value: float) -> str:
    return f"{value:.4g}" if abs(value) < 1e4 else f"{value:.0f}"


def _pairs(node: yaml.Node | None) -> dict[str, tuple[yaml.Node, yaml.Node]]:
    return {key.value: (key, value) for key, value in node.value} if isinstance(node, yaml.MappingNode) else {}


def _shared(root: yaml.Node) -> set[int]:
    """Return the identities of shared nodes, and of all nodes within shared nodes."""
    met, shared, waiting = set[int](), set[int](), [(root, False)]
    while waiting:
        node, within = waiting.pop()
        if id(node) in shared:
            continue
        if within or id(node) in met:
            shared.add(id(node))
        met.add(id(node))
        if isinstance(node, yaml.CollectionNode):
            parts = chain(*node.value) if isinstance(node, yaml.MappingNode) else node.value
            waiting += [(part, id(node) in shared) for part in parts]
    return shared


def _end(text: str, node: yaml.Node) -> int:
    """Return the end of a value in the text; a list or mapping in block style ends with the last value."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(text, last[1] if isinstance(last, tuple) else last)
    return len(text[: node.end_mark.index].rstrip())


def _insertion(text: str, node: yaml.MappingNode, added: list[str]) -> tuple[int, int, str]:
    """New keys at the end of a mapping."""
    end = _end(text, node.value[-1][1])
    if node.flow_style:
        return end, end, "".join(f", {each}" for each in added)
    line_end = text.find("\n", end)
    line_end = len(text) if line_end < 0 else line_end
    indent = " " * node.value[0][0].start_mark.column
    return line_end, line_end, "".join(f"\n{indent}{each}" for each in added)
