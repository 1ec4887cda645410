"""``python -m bench.chaos.switch PORT...``: a switch that loses, delays and reorders frames.

The kernel has no ``netem`` here. Each line of standard input is a new order, as JSON: ``loss`` and ``late``, shares of
the frames, and ``delay_s``, how much later those are that are late: others overtake them. A word is printed when the
switch works.
"""

import heapq
import itertools
import json
import select
import socket
import sys
from dataclasses import dataclass
from random import Random

from im_core import clock

_LONGEST_FRAME, _ALL_PROTOCOLS, _OUTGOING = 1 << 16, 3, 4


@dataclass(frozen=True)
class Weather:
    """What happens to frames.

    Attributes:
        loss: Share that is lost.
        late: Share that is delayed.
        delay_s: How long at most [s].
    """

    loss: float = 0.0
    late: float = 0.0
    delay_s: float = 0.0


def forward(names: list[str], draw: Random) -> None:
    """Forward frames between interfaces until standard input ends.

    Args:
        names: Of the interfaces.
        draw: Draws what is lost and late.
    """
    ports = [socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ALL_PROTOCOLS)) for _ in names]
    for port, name in zip(ports, names, strict=True):
        port.bind((name, 0))
        port.setblocking(False)
    weather, count = Weather(), itertools.count()
    waiting: list[tuple[float, int, int, bytes]] = []
    print("forwarding", flush=True)
    while True:
        patience = max(0.0, waiting[0][0] - clock.monotonic()) if waiting else None
        ready, _, _ = select.select([*ports, sys.stdin], [], [], patience)
        if sys.stdin in ready:
            line = sys.stdin.readline()
            if not line:
                return
            weather = Weather(**json.loads(line))
        now = clock.monotonic()
        for rank, port in enumerate(ports):
            for frame in _frames(port) if port in ready else ():
                if draw.random() < weather.loss:
                    continue
                later_s = draw.uniform(0.0, weather.delay_s) if draw.random() < weather.late else 0.0
                heapq.heappush(waiting, (now + later_s, next(count), rank, frame))
        while waiting and waiting[0][0] <= clock.monotonic():
            _, _, rank, frame = heapq.heappop(waiting)
            for port in ports[:rank] + ports[rank + 1 :]:
                _send(port, frame)


def _frames(port: socket.socket) -> list[bytes]:
    """Frames that have come to a port from its host."""
    frames: list[bytes] = []
    while True:
        try:
            frame, (_, _, kind, *_) = port.recvfrom(_LONGEST_FRAME)
        except OSError:  # none is left, or the cable is cut
            return frames
        if kind != _OUTGOING:
            frames.append(frame)


def _send(port: socket.socket, frame: bytes) -> None:
    try:
        port.send(frame)
    except OSError:  # its cable is cut, or its queue is full: a switch drops frames
        return


if __name__ == "__main__":
    forward(sys.argv[1:], Random(1))
