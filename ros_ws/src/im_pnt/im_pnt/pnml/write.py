"""Nets to PNML: standard parts in standard elements, and the rest in ``toolspecific``.

Places of other nets stand on a page of their own, and arcs lead to them through reference places.
"""

import re
from collections.abc import Iterator

from im_pnt.model.net import Net, Transition
from im_pnt.netfile.writer import describe, place_data, transition_data
from im_pnt.pnml.extras import REMOTE, escape, extras_text

_NAMESPACE = "http://www.pnml.org/version-2009/grammar/pnml"
_TYPE = "http://www.pnml.org/version-2009/grammar/ptnet"
_NCNAME = re.compile(r"[A-Za-z_][A-Za-z0-9_.-]{0,199}")
_OWN = re.compile(r"(arc|ref|remote|page)_?[0-9]*|remote_places")
"""Ids that the writer gives."""


class _Ids:
    """Ids of one file: a name where valid, else the name with other letters."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def make(self, name: str) -> str:
        identity = name if _NCNAME.fullmatch(name) and not _OWN.fullmatch(name) else ""
        if not identity:
            identity = re.sub(r"[^A-Za-z0-9_.-]", "_", name)[:190]
            identity = f"n_{identity}"
        base, number = identity, 1
        while identity in self._taken:
            number += 1
            identity = f"{base}.{number}"
        self._taken.add(identity)
        return identity


def pnml_text(net: Net) -> str:
    """Return a net as the text of a PNML file.

    Args:
        net: The net as written.

    Raises:
        NetError: An expanded net.
    """
    ids = _Ids()
    identity = ids.make(net.name)
    places = {name: ids.make(name) for name in net.places}
    transitions = {name: ids.make(name) for name in net.transitions}
    remote = {str(place): "" for t in net.transitions.values() for place in t.remote_outputs}
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>\n',
        f'<pnml xmlns="{_NAMESPACE}">\n',
        f'  <net id="{identity}" type="{_TYPE}">\n',
        _name(net.name, "    "),
        '    <page id="page_1">\n',
    ]
    for place in net.places.values():
        lines.append(f'      <place id="{places[place.name]}">\n{_name(place.name)}')
        if place.tokens:
            lines.append(f"        <initialMarking><text>{place.tokens}</text></initialMarking>\n")
        data = place_data(place)
        data.pop("tokens", None)
        lines.append(extras_text(data, "        ") + "      </place>\n")
    for number, place_name in enumerate(remote, 1):
        remote[place_name] = f"ref_{number}"
        lines.append(f'      <referencePlace id="ref_{number}" ref="remote_{number}"/>\n')
    for transition in net.transitions.values():
        shown = _name(transition.name)
        lines.append(f'      <transition id="{transitions[transition.name]}">\n{shown}')
        lines.append(extras_text(_more(transition), "        ") + "      </transition>\n")
    arcs = (arc for t in net.transitions.values() for arc in _arcs(t, transitions[t.name], places, remote))
    lines += [_arc(number, *arc) for number, arc in enumerate(arcs, 1)]
    lines.append("    </page>\n")
    if remote:
        lines.append('    <page id="remote_places">\n')
        for number, place_name in enumerate(remote, 1):
            own = extras_text({REMOTE: place_name}, "        ")
            lines.append(f'      <place id="remote_{number}">\n{_name(place_name)}{own}      </place>\n')
        lines.append("    </page>\n")
    data = describe(net)
    for key in ("places", "transitions"):
        del data[key]
    lines.append(extras_text(data, "    ") + "  </net>\n</pnml>\n")
    return "".join(lines)


def _name(text: str, indent: str = "        ") -> str:
    return f"{indent}<name><text>{escape(text)}</text></name>\n"


def _more(transition: Transition) -> dict[str, object]:
    data = transition_data(transition)
    return {key: value for key, value in data.items() if key not in ("in", "out")}


def _arcs(
    transition: Transition, identity: str, places: dict[str, str], remote: dict[str, str]
) -> Iterator[tuple[str, str, int]]:
    for place, weight in transition.inputs.items():
        yield places[place], identity, weight
    for place, weight in transition.outputs.items():
        yield identity, places[place], weight
    for target, weight in transition.remote_outputs.items():
        yield identity, remote[str(target)], weight


def _arc(number: int, source: str, target: str, weight: int) -> str:
    head = f'      <arc id="arc_{number}" source="{source}" target="{target}"'
    return f"{head}/>\n" if weight == 1 else f"{head}><inscription><text>{weight}</text></inscription></arc>\n"
