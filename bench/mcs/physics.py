"""The testbed's physics process, as fast as it goes or in real time, for one measurement."""

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from im_cell.link import HostEnd
from im_cell.robot import Cell
from im_core import names
from im_core.errors import LinkError
from im_core.processes.process import ChildProcess
from im_core.shm_names import remove_all

_ATTACH_S = 20.0
_NUMBERS = itertools.count()


def new_instance() -> str:
    """A name for a machine that nobody else on this host has."""
    return f"{names.instance()}_bench_{os.getpid()}_{next(_NUMBERS)}"


@contextmanager
def physics(instance: str, cell: Cell, factor: float, seed: int, folder: Path) -> Iterator[tuple[HostEnd, int]]:
    """A running physics process: its end of the link, and its pid; ended and cleared away afterwards.

    Args:
        instance: Name of the machine.
        cell: The machine's cell, maybe with another period.
        factor: Clock factor; 0: as fast as it goes.
        seed: Of the encoder noise.
        folder: For the log.

    Raises:
        LinkError: It does not start; its last words.
    """
    arguments = ["--instance", instance, "--factor", repr(factor), "--seed", str(seed), "--period", repr(cell.period)]
    process = ChildProcess.of_module("im_sim.physics", arguments, log=folder / "physics.log")
    try:
        link = HostEnd.attach(instance, _ATTACH_S)
        try:
            yield link, process.pid
        finally:
            link.close()
    except LinkError:
        process.check()
        raise
    finally:
        process.stop()
        remove_all(f"{instance}_")
