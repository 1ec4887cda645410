"""The testbed's physics process, as fast as it goes or in real time, for one measurement."""

import itertools
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from im_core import names, shm
from im_core.errors import LinkError
from im_core.robot import Cell
from im_core.testbed_link import TestbedLink

_ATTACH_S = 20.0
_NUMBERS = itertools.count()


def new_instance() -> str:
    """A name for a machine that nobody else on this host has."""
    return f"{names.instance()}_bench_{os.getpid()}_{next(_NUMBERS)}"


def cpu_s(pid: int) -> float:
    """CPU time that a process has used so far [s]."""
    return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[0]) * 1e-9


@contextmanager
def physics(instance: str, cell: Cell, factor: float, seed: int, folder: Path) -> Iterator[tuple[TestbedLink, int]]:
    """A running physics process: the link to it and its pid; ended and cleared away afterwards.

    Args:
        instance: Name of the machine.
        cell: Its parameters.
        factor: Clock factor; 0: as fast as it goes.
        seed: Of the encoder noise.
        folder: For the file of parameters and the log.

    Raises:
        LinkError: It does not start; its last words.
    """
    file, log = folder / "cell.yaml", folder / "physics.log"
    file.write_text(cell.model_dump_json(), encoding="utf-8")  # JSON is YAML
    arguments = ["--instance", instance, "--config", str(file), "--factor", repr(factor), "--seed", str(seed)]
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "im_sim.physics", *arguments], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        link = TestbedLink.attach(instance, _ATTACH_S)
        try:
            yield link, process.pid
        finally:
            link.close()
    except LinkError as error:
        if process.poll() is not None:
            raise LinkError(f"the physics process ended: {log.read_text(encoding='utf-8')[-400:]}") from error
        raise
    finally:
        process.terminate()
        process.wait()
        shm.remove_all(f"{instance}_")
