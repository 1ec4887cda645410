"""A recorder beside what is measured."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from im_core import clock
from im_core.errors import WaitTimeoutError
from im_core.processes.process import ChildProcess

_BAG_S = 60.0


@contextmanager
def recorder(bag: Path) -> Iterator[ChildProcess]:
    """All topics are recorded meanwhile.

    Yields:
        The recorder.

    Raises:
        WaitTimeoutError: It does not begin.
    """
    child = ChildProcess.of_module("im_bag.ros.recorder", ["-o", str(bag)], log=bag.with_suffix(".log"))
    try:
        deadline = clock.monotonic() + _BAG_S
        while not any(bag.glob("*.mcap")):
            child.check()
            if clock.monotonic() > deadline:
                raise WaitTimeoutError(what="the first file of the bag", seconds=_BAG_S)
            clock.sleep(0.1)
        yield child
    finally:
        child.stop()
