"""Other libraries of the field, in an environment of their own: never imported, only asked."""

import hashlib
import shutil
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bench.nets.workers import Worker
from im_core.errors import LinkError
from im_pnt.model.net import Net

_ROOT = Path(__file__).resolve().parents[2]


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

        Raises:
            LinkError: There is no environment, or it cannot be started.
        """
        if self.python is None:
            raise LinkError(self.missing or "the peers are not installed", peer=peer)
        return Worker(peer, [str(self.python), "-E", str(self.folder / f"{peer}_peer.py"), *options])


@cache
def installed_peers(root: Path = _ROOT) -> Peers:
    """The peers, installed from ``bench/peers/requirements.txt`` into ``.venv-peers`` unless they are there."""
    folder, environment = root / "bench" / "peers", root / ".venv-peers"
    requirements, python, stamp = folder / "requirements.txt", environment / "bin" / "python", environment / "installed"
    wanted = f"{hashlib.sha256(requirements.read_bytes()).hexdigest()} {environment}\n"  # it is of no use elsewhere
    if not stamp.exists() or stamp.read_text(encoding="utf-8") != wanted:
        print(f"bench: installing the peers into {environment} (once)", file=sys.stderr, flush=True)
        shutil.rmtree(environment, ignore_errors=True)
        pip = (sys.executable, "-m", "pip", "--python", str(python), "--disable-pip-version-check", "install")
        for command in (
            (sys.executable, "-m", "venv", "--without-pip", str(environment)),
            (*pip, "--quiet", "--requirement", str(requirements)),
        ):
            if subprocess.run(command, stdin=subprocess.DEVNULL, stdout=sys.stderr, check=False).returncode != 0:
                missing = f"the peers could not be installed into {environment.name}"
                print(f"bench: {missing}; their rows say so", file=sys.stderr, flush=True)
                return Peers(None, folder, missing)
        stamp.write_text(wanted, encoding="utf-8")
    return Peers(python, folder)


def plain(net: Net) -> dict[str, object]:
    """Returns a net as peers read it; all its arcs have weight 1."""
    return {
        "places": {place.name: place.tokens for place in net.places.values()},
        "transitions": {t.name: [list(t.inputs), list(t.outputs)] for t in net.transitions.values()},
    }
