"""A net in its executor, with observer and journal as in a node; and the process that fires it on request."""

import enum
from collections.abc import Coroutine, Sequence
from dataclasses import replace
from pathlib import Path

from bench.nets.serving import serve
from im_core.clock import cpu
from im_core.errors import StateError
from im_pnt.distributed.exchange import Exchange
from im_pnt.distributed.link import Link
from im_pnt.execution.actions import FunctionRunner, Runner
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.notification import Firing, Observer
from im_pnt.journal.journal import Journal
from im_pnt.model.net import Guard, Net
from im_pnt_analysis.simulation.families import ACTION, philosophers, ring

GUARD = "always"
"""Name of the guard of guarded transitions."""
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
    """What each transition of a net has to do beside moving tokens."""

    NONE = "no action"
    ACTION = "a Python action"
    GUARDED = "guard and action"


def working(family: str, places: int, work: Work) -> Net:
    """Returns a net of a family whose transitions have work to do."""
    net = _FAMILIES[family](places, work is not Work.NONE)
    if work is not Work.GUARDED:
        return net
    guarded = {name: replace(each, guard=Guard(GUARD)) for name, each in net.transitions.items()}
    return replace(net, transitions=guarded)


class Player:
    """A net that fires by itself for ever, told to an observer and, where there is a folder, to a journal.

    Args:
        net: The net; its actions are called :data:`~im_pnt_analysis.simulation.families.ACTION`, its guards
            :data:`GUARD`.
        folder: Folder of the journal; None: none is kept.
    """

    def __init__(self, net: Net, folder: Path | None = None) -> None:
        calls = [0]

        def count(_: ActionContext) -> None:
            calls[0] += 1

        functions = Functions({ACTION: count}, {GUARD: lambda _: True})
        self._journal = None if folder is None else Journal(folder, "bench")
        exchange = Exchange("bench", 1)
        runner: Runner = FunctionRunner(functions, exchange, never)
        record = None
        if self._journal is not None:
            runner, record = self._journal.guard(runner), self._journal.recorder(net.name)
        self._calls = calls
        self._acts = bool(net.functions())
        self.observer = Counter()
        self.executor = Executor(net, functions, runner, exchange, self.observer, record=record)
        exchange.add(self.executor)
        if self._journal is not None:
            link = Link("bench", 1, exchange.receive, exchange.refused, _silent, _silent, _silent)
            self._journal.start(exchange, link)

    @property
    def fired(self) -> int:
        """How often its transitions have fired; one with an action counts once."""
        return self._calls[0] if self._acts else self.executor.sequence

    def fire(self, firings: int) -> int:
        """Fires so many times, or a few more, in turns as a node does, and writes the journal after each.

        Returns:
            How often it fired.

        Raises:
            StateError: The net came to rest.
        """
        begin = self.fired
        while (left := firings - (self.fired - begin)) > 0:
            if not self.executor.pump(min(left, TURN)):
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
        players[:] = [Player(net, Path(folder) if folder else None)]
        return {}

    def fire(request: dict[str, object]) -> dict[str, object]:
        began = cpu()
        fired = players[0].fire(int(str(request["firings"])))
        return {"firings": fired, "cpu_s": cpu() - began}

    serve({"load": load, "fire": fire})


if __name__ == "__main__":
    main()
