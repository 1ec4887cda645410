"""Tapes (paper, section 6): the input tape gives commands to a net, the output tape acknowledges them."""

from collections import deque

from im_pnt.jobs import Job

DONE_SUFFIX = "_done"
FAILED_SUFFIX = "_failed"


class InputTape:
    """Symbols that wait to be read, with the jobs they stand for; a transition reads the oldest of its symbol."""

    def __init__(self) -> None:
        self._waiting: dict[str, deque[Job]] = {}

    def write(self, job: Job) -> None:
        """Puts a job at the end."""
        job.from_tape = job.waiting = True
        self._waiting.setdefault(job.symbol, deque()).append(job)

    def has(self, symbol: str) -> bool:
        """Whether a symbol is on the tape."""
        return bool(self._waiting.get(symbol))

    def first(self, symbol: str) -> Job:
        """Returns the oldest job of a symbol, and leaves it on the tape.

        Raises:
            LookupError: The symbol is not there.
        """
        return self._waiting[symbol][0]

    def read(self, symbol: str) -> Job:
        """Takes the oldest job of a symbol from the tape.

        Raises:
            LookupError: The symbol is not there.
        """
        job = self._waiting[symbol].popleft()
        job.waiting = False
        return job

    def withdraw(self, job: Job) -> bool:
        """Takes a job from the tape, wherever it is; returns whether it was there."""
        if not job.waiting:
            return False
        self._waiting[job.symbol].remove(job)
        job.waiting = False
        return True

    def waiting(self) -> list[Job]:
        """Returns the jobs on the tape, symbol by symbol."""
        return [job for jobs in self._waiting.values() for job in jobs]


def ends(emitted: str, symbol: str) -> bool | None:
    """Whether an output symbol says that a command is done (True), failed (False), or neither (None)."""
    if emitted == symbol + DONE_SUFFIX:
        return True
    return False if emitted == symbol + FAILED_SUFFIX else None
