"""The plug of a whole machine: its run folder is on a disk that forgets."""

import os
from pathlib import Path
from random import Random

from bench.power.disk import Disk
from im_bringup.machine import leftovers


class Plug:
    """What is started while it is in loses its power when it is pulled.

    Args:
        folder: The run folder; nothing writes there yet.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._put_in()

    def pull(self, draw: Random) -> None:
        """The power goes, and comes back; all processes have been killed, and what is in memory is gone."""
        self._disk.lose_power(draw)
        leftovers.remove_shared_memory()
        self._put_in()

    def close(self) -> None:
        """No process that is started from now on loses anything."""
        for name in self._disk.environment:
            os.environ.pop(name)
        self._disk.close()

    def _put_in(self) -> None:
        self._disk = Disk(self._folder)
        os.environ.update(self._disk.environment)
