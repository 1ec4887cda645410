"""Figures of remote tokens: the round trip between two processes, next to that of a bare topic in the same run."""

from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from bench.figures import Line
from bench.nets.workers import Worker, number, own
from im_core.errors import LinkError

MOST_TIMES_BARE = 1.5
MOST_TIMES_SPUN = 1.0
IDLE_SUBSCRIPTIONS = (0, 100)
_PATIENCE_S = 60.0


@dataclass(slots=True)
class Trips:
    """Round trips of one kind.

    Attributes:
        seconds: How long each took [s].
        cpu_s: CPU time of one of the two processes for all of them [s].
    """

    seconds: list[float] = field(default_factory=list)
    cpu_s: float = 0.0

    def add(self, worker: Worker, trips: int) -> None:
        """Has a process make round trips.

        Raises:
            LinkError: A token does not come back, or the process has died.
        """
        answer = worker.ask("play", patience=_PATIENCE_S, trips=trips)
        times = answer["trips_s"]
        if not isinstance(times, list) or not answer["finished"]:
            raise LinkError(f"{worker.name} did not make {trips} round trips in time", worker=worker.name)
        self.seconds += [float(time) for time in times]
        self.cpu_s += number(answer, "cpu_s")

    def quantile(self, share: float) -> float:
        """Returns a quantile of the durations [µs]."""
        return 1e6 * sorted(self.seconds)[min(len(self.seconds) - 1, int(share * len(self.seconds)))]

    def cpu(self) -> float:
        """Returns the CPU time of one process for a round trip [µs]."""
        return 1e6 * self.cpu_s / len(self.seconds)


def lines(trips: int, rounds: int, folder: Path) -> list[Line]:
    """Round trips of a token and of a bare message with two executors, in turns, without and with idle subscriptions.

    Raises:
        LinkError: A node does not start, or a token does not come back.
    """
    found: list[Line] = []
    for idle in IDLE_SUBSCRIPTIONS:
        token, topic, spun = _measure(trips, rounds, idle, folder / f"idle_{idle}")
        suffix = f", {idle} idle subscriptions" if idle else ""
        name = f"remote token, round trip{suffix}"
        found += [
            Line(name, token.quantile(0.5), "µs", topic.quantile(0.5), "bare topic", MOST_TIMES_BARE),
            Line(
                "  beside rclpy.spin", token.quantile(0.5), "µs", spun.quantile(0.5), "its bare topic", MOST_TIMES_SPUN
            ),
            Line("  99th percentile", token.quantile(0.99), "µs", topic.quantile(0.99), "bare topic"),
            Line("  CPU of one of the nodes", token.cpu(), "µs", topic.cpu(), "bare topic"),
        ]
    return found


def _measure(trips: int, rounds: int, idle: int, folder: Path) -> tuple[Trips, Trips, Trips]:
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:

        def start(module: str, side: str, *options: str) -> Worker:
            return stack.enter_context(own(f"bench.nets.nodes.{module}", side, str(idle), *options))

        for spin in ("events", "rclpy"):
            start("bare", "pong", spin)
        bare, plain = (start("bare", "ping", spin) for spin in ("events", "rclpy"))
        pong, ball = (start("ball", side, str(folder)) for side in ("pong", "ping"))
        for worker in (bare, plain, pong, ball):
            failed = worker.ask("ready", patience=_PATIENCE_S).get("failed")
            if failed:
                raise LinkError(f"{worker.name} does not start: {failed}", worker=worker.name)
        for worker in (bare, plain, ball):
            Trips().add(worker, max(20, trips // 10))
        token, topic, spun = Trips(), Trips(), Trips()
        for _ in range(rounds):
            token.add(ball, trips)
            topic.add(bare, trips)
            spun.add(plain, trips)
    return token, topic, spun
