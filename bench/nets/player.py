"""A net in its executive, as nodes run it, whose actions only count; and the process that fires it on request."""

from collections.abc import Coroutine

from im_core.clock import cpu
from im_core.errors import StateError
from im_pnt.bench.nets import ACTION, philosophers, ring
from im_pnt.bench.serving import serve
from im_pnt.events import Firing, Observer
from im_pnt.exchange import Exchange
from im_pnt.executive import Executive
from im_pnt.functions import Functions
from im_pnt.net import Net
from im_pnt.runner import FunctionRunner

_FAMILIES = {"ring": ring, "philosophers": philosophers}


class Counter(Observer):
    """Counts the firings it is told of."""

    def __init__(self) -> None:
        self.count = 0

    def fired(self, firing: Firing) -> None:
        """Counts a firing."""
        self.count += 1


class Player:
    """A net that fires by itself for ever, with or without actions.

    Args:
        net: The net; its actions are called :data:`~im_pnt.bench.nets.ACTION`.
        observed: Whether an observer is told of each firing, as the one of a node is.
    """

    def __init__(self, net: Net, observed: bool = False) -> None:
        calls = [0]

        def count(_: object) -> None:
            calls[0] += 1

        functions = Functions({ACTION: count})
        exchange = Exchange("bench", 1)
        runner = FunctionRunner(functions, exchange, never)
        self._calls = calls
        self._acts = bool(net.functions())
        self.observer = Counter() if observed else Observer()
        self.executive = Executive(net, functions, runner, exchange, self.observer)
        exchange.add(self.executive)

    @property
    def fired(self) -> int:
        """How often its transitions have fired; one with an action counts once."""
        return self._calls[0] if self._acts else self.executive.sequence

    def fire(self, firings: int) -> int:
        """Fires so many times, or a few more.

        Returns:
            How often it fired.

        Raises:
            StateError: The net came to rest.
        """
        begin = self.fired
        while (left := firings - (self.fired - begin)) > 0:
            if not self.executive.pump(left):
                raise StateError(f"net {self.executive.net.name} came to rest after {self.fired} firings")
        return self.fired - begin


def never(work: Coroutine[object, object, None]) -> None:
    """Refuses a coroutine: no action of these nets waits.

    Raises:
        StateError: Always.
    """
    work.close()
    raise StateError("an action of the benchmark waits")


def main() -> None:
    """Serves ``load`` (family, places, action, observed) and ``fire`` (firings)."""
    players: list[Player] = []

    def load(request: dict[str, object]) -> dict[str, object]:
        family, places = str(request["family"]), int(str(request["places"]))
        players[:] = [Player(_FAMILIES[family](places, bool(request["action"])), bool(request["observed"]))]
        return {}

    def fire(request: dict[str, object]) -> dict[str, object]:
        began = cpu()
        fired = players[0].fire(int(str(request["firings"])))
        return {"firings": fired, "cpu_s": cpu() - began}

    serve({"load": load, "fire": fire})


if __name__ == "__main__":
    main()
