"""Names of the local computer."""

import ipaddress
import socket

#: Of every computer for itself.
HERE = ("localhost", "127.0.0.1", "::1")


def is_everywhere(host: str) -> bool:
    """Return whether a host name stands for all addresses of the computer."""
    address = address_of(host)
    return not host or (address is not None and address.is_unspecified)


def served_names(host: str) -> set[str]:
    """Return the names of a listening address; for all addresses, with the names of the computer."""
    if not is_everywhere(host):
        return {*HERE, host.lower().strip("[]")}
    return {*HERE, socket.gethostname().lower(), socket.getfqdn().lower()}


def address_of(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Return the address in a text; None for a name."""
    try:
        return ipaddress.ip_address(text.partition("%")[0].strip("[]"))
    except ValueError:
        return None
