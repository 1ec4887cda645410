"""Packets of RTPS 2.3 made by hand, as any process can send them on the loopback (OMG DDSI-RTPS, 8.3 and 9.4)."""

import contextlib
import socket
import struct
from pathlib import Path

#: Reads what all readers of a writer read.
_ANY_READER = bytes(4)
_LITTLE_ENDIAN = 1


def gap(writer, first, behind):
    """Tell readers that a writer has no numbers from the first to the one before the last.

    Args:
        writer: Its GUID, 16 bytes.
        first: First number that is missing.
        behind: The number behind those that are missing.
    """
    return _packet(writer, 0x08, _number(first) + _number(behind) + struct.pack("<I", 0))


def heartbeat(writer, first, last):
    """Tell readers which numbers a writer has: from the first to the last."""
    return _packet(writer, 0x07, _number(first) + _number(last) + struct.pack("<i", 2**30))


def data_frag(writer, number, size):
    """Send readers the first kilobyte of a sample, of which eight bytes are there.

    Args:
        writer: GUID of its writer.
        number: Of the sample.
        size: Of the sample [bytes].
    """
    told = struct.pack("<IHHI", 1, 1, 1024, size)
    return _packet(writer, 0x16, _number(number) + told + bytes(8), before=struct.pack("<HH", 0, 28))


def _packet(writer, kind, told, before=b""):
    body = before + _ANY_READER + writer[12:] + told
    return b"RTPS\x02\x03\x01\x0f" + writer[:12] + struct.pack("<BBH", kind, _LITTLE_ENDIAN, len(body)) + body


def _number(number):
    return struct.pack("<iI", number >> 32, number & 0xFFFFFFFF)


def send(packet, pid):
    """Send a packet to each port of the loopback at which a process listens."""
    for port in ports_of(pid):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            sender.sendto(packet, ("127.0.0.1", port))


def ports_of(pid):
    """Find the UDP ports of the loopback that a process has bound."""
    sockets = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            sockets.add(descriptor.readlink().name)
    lines = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    locals_ = [line[1].split(":") for line in lines if f"socket:[{line[9]}]" in sockets]
    return [int(port, 16) for address, port in locals_ if address == "0100007F"]
