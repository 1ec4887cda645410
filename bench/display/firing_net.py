"""A net of rings whose tokens go round at a rate, shown by a display."""

import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from im_core import clock
from im_pnt.netfile import parse_net
from im_pnt_display import DisplayServer
from im_pnt_display.page.state import net_content

NAME = "rings"
_TICK_S = 0.02
"""A node publishes its marking fifty times a second at most."""


def rings_text(rings: int, length: int) -> str:
    """The text of a net: rings of places, with a token each."""
    ends = [(ring, at, (at + 1) % length) for ring in range(rings) for at in range(length)]
    places = [f"  p{ring}_{at}: {'' if at else 1}" for ring, at, _ in ends]
    moves = [f"  t{ring}_{at}: {{in: p{ring}_{at}, out: p{ring}_{after}}}" for ring, at, after in ends]
    return "\n".join([f"net: {NAME}", "places:", *places, "transitions:", *moves, ""])


@contextmanager
def shown_firing(rings: int, length: int, per_s: float) -> Iterator[DisplayServer]:
    """A display as that of a machine, over a net that fires until the end of the context."""
    server = DisplayServer(port=0, apart=True)
    end = threading.Event()
    server.start()

    def fire() -> None:
        chance, at, sequence, began = random.Random(1), [0] * rings, 0, clock.monotonic()
        while not end.wait(_TICK_S):
            while sequence < (clock.monotonic() - began) * per_s:
                ring = chance.randrange(rings)
                sequence += 1
                server.show({"kind": "firing", **_firing(f"t{ring}_{at[ring]}", sequence, clock.monotonic() - began)})
                at[ring] = (at[ring] + 1) % length
            tokens = {f"p{ring}_{place}": 1 for ring, place in enumerate(at)}
            server.show({"kind": "marking", "net": NAME, "tokens": tokens, "sequence": sequence, **_AUTOMATIC})

    firing = threading.Thread(target=fire, name="rings", daemon=True)
    try:
        server.show({"kind": "net", "net": NAME, "node": "/rings", **net_content(parse_net(rings_text(rings, length)))})
        firing.start()
        try:
            yield server
        finally:
            end.set()
            firing.join()
    finally:
        server.stop()


_AUTOMATIC = {"active": [], "cancelling": [], "in_doubt": [], "proposed": [], "mode": "automatic", "paused": False}


def _firing(transition: str, sequence: int, at_s: float) -> dict[str, object]:
    told = {"symbol": "", "command": 0, "message": "", "duration": 0.0, "progress": -1.0, "phase": "END"}
    return {"time": at_s, "net": NAME, "transition": transition, "sequence": sequence, **told}
