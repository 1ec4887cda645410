"""Under which names this computer is known."""

import ipaddress
import socket

#: Of every computer for itself.
HERE = ("localhost", "127.0.0.1", "::1")


def is_everywhere(host: str) -> bool:
    """Whether who listens there listens on all addresses of this computer."""
    address = address_of(host)
    return not host or (address is not None and address.is_unspecified)


def served_names(host: str) -> set[str]:
    """Returns the names of what listens somewhere; those of this computer, too, if that is everywhere."""
    if not is_everywhere(host):
        return {*HERE, host.lower().strip("[]")}
    return {*HERE, socket.gethostname().lower(), socket.getfqdn().lower()}


def address_of(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Returns the address that a text is; None: it is none, but a name."""
    try:
        return ipaddress.ip_address(text.partition("%")[0].strip("[]"))
    except ValueError:
        return None
