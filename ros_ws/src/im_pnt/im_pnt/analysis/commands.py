"""Commands that one net writes to the tape of another, and their acknowledgement (paper, section 6).

A caller's command waits in ``t.on_tape``; a transition that reads its symbol may take it from there, which marks
``t.read``. The output symbol ``<symbol>_done`` or ``<symbol>_failed`` ends it. While a command of a caller is read, it
is what such an output symbol acknowledges; the tape is free besides: others may write the same symbol at any time.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from im_pnt.analysis.flat import Flat
from im_pnt.expand import cancelling_place
from im_pnt.net import Net, Place, Role, Transition
from im_pnt.tape import ends


@dataclass(frozen=True, slots=True)
class Caller:
    """A transition that asks another net: its qualified name, and whether a time-out lets it give up."""

    name: str
    gives_up: bool

    def endings(self) -> Iterator[tuple[str, str, str]]:
        """Yields for each way in which it waits a suffix, the place where it waits, and the one that a reply marks."""
        yield "", f"{self.name}.pending", f"{self.name}.reply"
        if self.gives_up:
            yield " given up", f"{self.name}.abandoned", f"{self.name}.patience"


class Commands:
    """Connects transitions that write commands with those that read and acknowledge them.

    Args:
        flat: The net that grows.
    """

    def __init__(self, flat: Flat) -> None:
        self._flat = flat
        self._callers: dict[str, list[tuple[str, Caller]]] = {}

    def expect(self, net: str, symbol: str, caller: Caller) -> None:
        """Notes that a caller writes a symbol to the tape of a net."""
        self._callers.setdefault(net, []).append((symbol, caller))

    def write(self, net: str, caller: Caller) -> str:
        """Adds the places of a command; returns the one that stands for its being on the tape."""
        flat, on_tape = self._flat, f"{caller.name}.on_tape"
        flat.add_place(net, Place(on_tape))
        flat.add_place(net, Place(f"{caller.name}.read"))
        cancelling = cancelling_place(caller.name)
        for suffix, waiting, answered in caller.endings():
            kept = {} if suffix else {cancelling: 1}
            flat.add_transition(
                Transition(
                    f"withdraw({caller.name}{suffix})",
                    {on_tape: 1, waiting: 1, **kept},
                    {answered: 1, **kept},
                    role=Role.ENVIRONMENT,
                    origin=caller.name,
                )
            )
        return on_tape

    def served(self, net: Net, flat: Transition) -> Iterator[Transition]:
        """Returns a transition in all the ways in which it reads and acknowledges commands of callers.

        Args:
            net: Its net.
            flat: The transition with qualified names.
        """
        callers = self._callers.get(net.name, [])
        yield from self._acknowledging(flat, callers)
        for symbol, caller in callers:
            if flat.symbol == symbol:
                reading = replace(
                    flat,
                    name=f"{flat.name}({caller.name})",
                    symbol=None,
                    inputs={**flat.inputs, f"{caller.name}.on_tape": 1},
                    outputs={**flat.outputs, f"{caller.name}.read": 1},
                )
                if any(ends(emitted, symbol) is not None for emitted in flat.emit):
                    for suffix, waiting, answered in caller.endings():
                        yield replace(
                            reading,
                            name=f"{reading.name}{suffix}",
                            inputs={**reading.inputs, waiting: 1},
                            outputs={**flat.outputs, answered: 1},
                        )
                else:
                    yield reading

    def _acknowledging(self, flat: Transition, callers: list[tuple[str, Caller]]) -> Iterator[Transition]:
        served = [c for symbol, c in callers if any(ends(e, symbol) is not None for e in flat.emit)]
        if flat.symbol is not None or not served:
            yield flat
            return
        reads = {f"{caller.name}.read": 1 for caller in served}
        yield replace(flat, inhibitors={**flat.inhibitors, **reads})
        for caller in served:
            for suffix, waiting, answered in caller.endings():
                yield replace(
                    flat,
                    name=f"{flat.name}({caller.name}{suffix})",
                    inputs={**flat.inputs, f"{caller.name}.read": 1, waiting: 1},
                    outputs={**flat.outputs, answered: 1},
                )
