"""Groups of nets for a common verification: communicating nets, over requests or remote places.

They may do so by any number of others in between. What nets of different groups do cannot matter to each other.
"""

from collections.abc import Iterable, Sequence

from im_pnt.errors import NetError
from im_pnt.model.net import Net


def groups(nets: Sequence[Net]) -> list[list[Net]]:
    """Divide nets into groups without communication between the groups, in the given order.

    Args:
        nets: Nets of different names.
    """
    known = {net.name for net in nets}
    group_of = {name: {name} for name in known}
    for net in nets:
        for partner in net.partners() & known:
            joined = group_of[net.name] | group_of[partner]
            for name in joined:
                group_of[name] = joined
    first = {min(rank for rank, net in enumerate(nets) if net.name in group) for group in group_of.values()}
    return [[net for net in nets if net.name in group_of[nets[rank].name]] for rank in sorted(first)]


def group_of(net: Net, others: Sequence[Net]) -> list[Net]:
    """Return a net with the direct and indirect partners among others, replacing a net of the same name."""
    return groups([net, *(other for other in others if other.name != net.name)])[0]


def nets_by_name(nets: Iterable[Net]) -> dict[str, Net]:
    """Return nets by the names.

    Raises:
        NetError: Two have the same.
    """
    found: dict[str, Net] = {}
    for net in nets:
        if net.name in found:
            both = f"{found[net.name].source} and {net.source}"
            raise NetError(f"there are two nets named {net.name}: {both}", net=net.name)
        found[net.name] = net
    return found


def require_one_reader(nets: Iterable[Net]) -> None:
    """Check whether each symbol begins a command of one net only: otherwise the executing net is undefined.

    Raises:
        NetError: Two nets of a node read one.
    """
    owners: dict[str, Net] = {}
    for net in nets:
        for symbol in () if net.former else net.begun_symbols():
            if (other := owners.setdefault(symbol, net)) is not net:
                both = f"nets {other.name} ({other.source}) and {net.name} ({net.source})"
                raise NetError(f"{both} both have the command {symbol}", symbol=symbol, nets=[other.name, net.name])
