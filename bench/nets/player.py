"""A net that works for a command, with observer and journal as in a node; and the process that fires it on request."""

import enum
from collections.abc import Coroutine, Sequence
from dataclasses import replace
from pathlib import Path

from bench.nets.families import ACTION, philosophers, ring
from bench.nets.serving import serve
from im_core.clock import cpu
from im_core.errors import StateError
from im_pnt.execution.actions import Runner
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Command
from im_pnt.execution.notification import Firing, Observer
from im_pnt.execution.runner import FunctionRunner
from im_pnt.model.net import Guard, Net, Place, Transition
from im_pnt_node.distributed.exchange import Exchange
from im_pnt_node.distributed.link import Link
from im_pnt_node.journal.journal import Journal

SYMBOL = "go"
"""Symbol of the command that the nets work for."""
GUARD, OVER = "go_on", "over"
"""Names of the guard of guarded transitions, and of the guard of the transition that ends the command."""
TURN = 1000
"""Most firings of a turn."""
_FAMILIES = {"ring": ring, "philosophers": philosophers}


class Counter(Observer):
    """Counts the firings it is told of."""

    def __init__(self) -> None:
        self.count = 0

    def fired(self, firings: Sequence[Firing]) -> None:
        """Counts firings."""
        self.count += len(firings)


class Work(enum.StrEnum):
    """What each transition of a net has to do beside moving tokens and telling an observer."""

    NONE = "no action"
    ACTION = "action"
    ALL = "guard, action, observer and journal"


def working(family: str, places: int, work: Work) -> Net:
    """Return a net of a family that works for a command, and whose transitions have work to do."""
    net = commanded(_FAMILIES[family](places, work is not Work.NONE))
    if work is not Work.ALL:
        return net
    guarded = {
        name: replace(each, guard=Guard(GUARD)) if each.action is not None else each
        for name, each in net.transitions.items()
    }
    return replace(net, transitions=guarded)


def commanded(net: Net) -> Net:
    """Return a net whose tokens belong to a command, but for those of its resources.

    The command begins with :data:`SYMBOL` and may end, as verification demands, where the net is marked as at its
    beginning and the guard :data:`OVER` says so.

    Args:
        net: A net without symbols; a place called ``fork...`` holds a resource.
    """
    own = {place.name: place.tokens for place in net.places.values() if place.tokens and place.name[:4] != "fork"}
    places = {name: replace(place, tokens=0) if name in own else place for name, place in net.places.items()}
    places["order"] = Place("order", 1)
    ends = (
        Transition("begin", inputs={"order": 1}, outputs=own, symbol=SYMBOL, origin="begin"),
        Transition("end", inputs=own, outputs={"order": 1}, emit=(f"{SYMBOL}_done",), guard=Guard(OVER), origin="end"),
    )
    return replace(net, places=places, transitions={**net.transitions, **{each.name: each for each in ends}})


class Player:
    """A net that fires for one command for ever, told to an observer and, where there is one, to a journal.

    Args:
        net: The net, of :func:`working`.
        journal: The journal; None: none is kept. Where it brings the command back, that goes on.

    Raises:
        JournalError: The journal cannot be used.
    """

    def __init__(self, net: Net, journal: Journal | None = None) -> None:
        calls = [0]

        def count(_: ActionContext) -> None:
            calls[0] += 1

        functions = Functions({ACTION: count}, {GUARD: lambda _: True, OVER: lambda _: False})
        epoch = 1 if journal is None else journal.epoch
        exchange = Exchange("bench", epoch)
        runner: Runner = FunctionRunner(functions, exchange, never)
        record = None
        if journal is not None:
            runner, record = journal.guard(runner), journal.recorder(net.name)
        self._journal, self._calls = journal, calls
        self._acts = bool(net.functions())
        self.observer = Counter()
        self.executor = Executor(net, functions, runner, exchange, self.observer, record=record)
        exchange.add(self.executor)
        if journal is not None:
            journal.start(exchange, Link("bench", epoch, exchange.receive, exchange.refused, _silent, _silent, _silent))
        if not self.executor.busy():
            self.executor.command(Command(1, SYMBOL))

    @property
    def fired(self) -> int:
        """How often its transitions have fired; one with an action counts once."""
        return self._calls[0] if self._acts else self.executor.sequence

    def fire(self, firings: int, turn: int = TURN) -> int:
        """Fire so many times, or a few more, in turns as a node does, and write the journal after each.

        Returns:
            How often it fired.

        Raises:
            StateError: The net came to rest.
        """
        begin = self.fired
        while (left := firings - (self.fired - begin)) > 0:
            if not self.executor.pump(min(left, turn)):
                raise StateError(f"net {self.executor.net.name} came to rest after {self.fired} firings")
            if self._journal is not None:
                self._journal.commit()
        return self.fired - begin


def _silent(*_: object) -> None:
    """Nobody is there to be told."""


def never(work: Coroutine[object, object, None]) -> None:
    """Refuses a coroutine: no action of these nets waits.

    Raises:
        StateError: Always.
    """
    work.close()
    raise StateError("an action of the benchmark waits")


def main() -> None:
    """Serves ``load`` (family, places, work, folder; empty: no journal) and ``fire`` (firings)."""
    players: list[Player] = []

    def load(request: dict[str, object]) -> dict[str, object]:
        net = working(str(request["family"]), int(str(request["places"])), Work(str(request["work"])))
        folder = str(request["folder"])
        players[:] = [Player(net, Journal(Path(folder), "bench") if folder else None)]
        return {}

    def fire(request: dict[str, object]) -> dict[str, object]:
        began = cpu()
        fired = players[0].fire(int(str(request["firings"])))
        return {"firings": fired, "cpu_s": cpu() - began}

    serve({"load": load, "fire": fire})


if __name__ == "__main__":
    main()
