"""Other libraries of the field, in an environment of their own: never imported, only asked."""

from dataclasses import dataclass
from pathlib import Path

from bench.nets.workers import Worker
from im_core.errors import LinkError
from im_pnt.model.net import Net


@dataclass(frozen=True)
class Peers:
    """Where the peers are.

    Attributes:
        python: Interpreter of their environment; None: there is none.
        folder: Folder of their programs, ``<peer>_peer.py``.
        missing: Why there is no environment.
    """

    python: Path | None
    folder: Path
    missing: str = ""

    def start(self, peer: str, *options: str) -> Worker:
        """Starts the program of a peer.

        Args:
            peer: Its name.
            options: Options of the program.

        Raises:
            LinkError: There is no environment, or it cannot be started.
        """
        if self.python is None:
            raise LinkError(self.missing or "the peers are not installed", peer=peer)
        return Worker(peer, [str(self.python), "-E", str(self.folder / f"{peer}_peer.py"), *options])


def found_peers() -> Peers:
    """The peers where ``scripts/bench.sh`` has installed them."""
    root = Path(__file__).resolve().parents[2]
    python = root / ".venv-peers" / "bin" / "python"
    missing = "the peers could not be installed into .venv-peers"
    return Peers(python if python.exists() else None, root / "bench" / "peers", missing)


def plain(net: Net) -> dict[str, object]:
    """Returns a net as peers read it; all its arcs have weight 1."""
    return {
        "places": {place.name: place.tokens for place in net.places.values()},
        "transitions": {t.name: [list(t.inputs), list(t.outputs)] for t in net.transitions.values()},
    }
