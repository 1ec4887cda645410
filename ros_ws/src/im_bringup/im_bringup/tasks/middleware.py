"""Reach of the machine over DDS: the Fast DDS profile of the processes, chosen by the deployment."""

import fcntl
import socket
import struct
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from im_bringup.tasks.deployment import Deployment
from im_core.config import fault_in, package_file
from im_core.processes.host_record import LOOPBACK_PROFILE, OPEN_PROFILE, PROFILE, PROFILES

#: With it the rmw takes memory policy, publish mode and data sharing from the profile, all of which ours has.
QOS_FROM_PROFILE = "RMW_FASTRTPS_USE_QOS_FROM_XML"
#: Addresses at which discovery looks for others, also where no multicast goes; those of the user come first.
PEERS = "ROS_STATIC_PEERS"
#: How far discovery reaches. With LOCALHOST the rmw adds shared memory to what a profile has.
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"
#: Without it Fast DDS also reads a file of the working directory.
_SKIP = {"SKIP_DEFAULT_XML_FILE": "1"}
_PACKAGE = "im_bringup"
_LOOPBACK_ADDRESS = "127.0.0.1"
#: Requests for the flags of an interface and for its address (``linux/sockios.h``), and flags (``linux/if.h``).
_GET_FLAGS, _GET_ADDRESS = 0x8913, 0x8915
_UP, _LOOPBACK, _RUNNING = 0x1, 0x8, 0x40


def loopback_profile() -> Path:
    """Return the DDS profile for one host: no participant outside of the host is heard."""
    return package_file(_PACKAGE, f"config/{LOOPBACK_PROFILE}")


def open_profile() -> Path:
    """Return the DDS profile for several hosts: DDS listens on all network interfaces."""
    return package_file(_PACKAGE, f"config/{OPEN_PROFILE}")


def own_profile(base: Mapping[str, str]) -> str:
    """Return the profile set by the user instead of ours, or an empty string."""
    given = Path(base.get(PROFILE, ""))
    return "" if given.name in ("", *PROFILES) else str(given)


def middleware(base: Mapping[str, str], deployment: Deployment) -> dict[str, str]:
    """Return the environment variables for the DDS profile, the memory kept by DDS, and the peers of discovery.

    Args:
        base: Environment of whoever starts the machine.
        deployment: What is started; tasks on several hosts open it.
    """
    ours = open_profile() if len(deployment.hosts) > 1 else loopback_profile()
    named = base[PEERS].split(";") if base.get(PEERS) else [*deployment.addresses.values()]
    here = dict.fromkeys([*named, _LOOPBACK_ADDRESS])  # whoever names some looks nowhere else
    peers = {PEERS: ";".join(here)} if named else {}
    if own := own_profile(base):
        return {PROFILE: own, **_SKIP, **peers}
    return {PROFILE: str(ours), RANGE: "SUBNET", QOS_FROM_PROFILE: "1", **_SKIP, **peers}


def require_addresses(deployment: Deployment, path: Path) -> None:
    """Refuse addresses of hosts that no participant of DDS could look at.

    Raises:
        ConfigError: One is neither an IPv4 address nor a name that this host knows.
    """
    for host, address in deployment.addresses.items():
        try:
            socket.getaddrinfo(address, None, socket.AF_INET)
        except OSError as error:
            sentence = f"{address}: neither an IPv4 address nor a name that this host knows: {error.strerror}"
            raise fault_in(path, ("addresses", host), sentence) from error


def reach(base: Mapping[str, str], deployment: Deployment) -> str:
    """Return the user's notice on the DDS reach, as a clause; empty for one host unreachable from outside."""
    if own := own_profile(base):
        return f"DDS listens as {own} says ({PROFILE})"
    if len(deployment.hosts) > 1:
        return f"DDS listens on all interfaces, for hosts {', '.join(deployment.hosts)} (docs/security.md)"
    return ""


def has_link(address: str) -> bool:
    """Return whether an interface to other hosts is up: DDS finds none later than the first node of a process.

    Args:
        address: Of the interface; any counts where none has this one.
    """
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            with suppress(OSError):  # it has no address, or has gone
                (flags,) = struct.unpack_from("H", fcntl.ioctl(any_socket, _GET_FLAGS, request), 16)
                own = socket.inet_ntoa(fcntl.ioctl(any_socket, _GET_ADDRESS, request)[20:24])
                if not flags & _LOOPBACK:
                    found.append((own, flags & _UP and flags & _RUNNING))
    return any(up for own, up in [each for each in found if each[0] == address] or found)
