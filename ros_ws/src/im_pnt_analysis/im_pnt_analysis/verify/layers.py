"""Nets to verify together, and nets to verify one by one because the requests are always answered.

A net *comes to rest by itself* if it is back in its first marking whenever it does nothing, and so can take any request
again, whatever came before and however its own requests are answered. Who asks only such nets need not be verified with
them: verified alone, where a request is answered either way after some time, it has met all that they can do. Requests
in a circle, and tokens that nets send each other, are no such askings; nor are those of nets that rest in several ways,
as a lock that is taken by one request and given back by another; nor those of a service of whose callers its net
assumes something, for they are counted together.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from im_pnt.errors import NetError
from im_pnt.model.action import RequestAction
from im_pnt.model.net import Net
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.verify.proofs import kept
from im_pnt_analysis.verify.verdict import verify


def parts(nets: Sequence[Net], limits: SearchLimits) -> list[list[Net]]:
    """Divide communicating nets into parts to verify together.

    Args:
        nets: Nets of different names, each verified alone.
        limits: Where the search gives up for each net; it then counts as one that does not come to rest by itself.
    """
    by_name = {net.name: net for net in nets}
    asked = {net.name: _asked(net) & by_name.keys() for net in nets}
    reach = {name: _reach(name, asked) for name in by_name}
    calm = {
        name: comes_to_rest(by_name[name], limits)
        for name in by_name
        if any(name in others for others in asked.values())
    }
    of = {name: {name} for name in by_name}
    for net in nets:
        for partner in net.partners() & by_name.keys():
            sends = any(remote.net == partner for t in net.transitions.values() for remote in t.remote_outputs)
            circle = net.name in reach[partner]
            promised = not _services(net, partner).isdisjoint(by_name[partner].assume)
            if sends or circle or promised or not calm[partner] or not _reads_at_rest(by_name[partner], net):
                joined = of[net.name] | of[partner]
                for name in joined:
                    of[name] = joined
    seen: set[str] = set()
    found = []
    for net in nets:
        if net.name not in seen:
            seen |= of[net.name]
            found.append([each for each in nets if each.name in of[net.name]])
    return found


def comes_to_rest(net: Net, limits: SearchLimits) -> bool:
    """Return whether an idle net is always in the first marking; False where undecided."""
    try:
        return kept([net], partial(verify, [net], limits)).comes_to_rest is True
    except NetError:
        return False


def _requests(net: Net) -> Iterator[RequestAction]:
    for transition in net.transitions.values():
        if isinstance(transition.action, RequestAction):
            yield transition.action


def _asked(net: Net) -> set[str]:
    return {action.net for action in _requests(net)}


def _services(asking: Net, net: str) -> set[str]:
    """Return the services, and the symbols, of a net's requests to another one."""
    return {action.service for action in _requests(asking) if action.net == net}


def _reach(name: str, asked: Mapping[str, set[str]]) -> set[str]:
    """Return the nets asked by a net, directly or through others."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        for other in asked[waiting.pop()] - found:
            found.add(other)
            waiting.append(other)
    return found


def _reads_at_rest(net: Net, asking: Net) -> bool:
    """Return whether a net can begin, from the first marking, all requests of another one by a symbol."""
    first = net.initial_marking()
    symbols = _services(asking, net.name) - net.services.keys()
    return all(
        any(
            t.symbol == symbol
            and all(first.get(place, 0) >= weight for place, weight in t.inputs.items())
            and all(first.get(place, 0) < weight for place, weight in t.inhibitors.items())
            for t in net.transitions.values()
        )
        for symbol in symbols
    )
