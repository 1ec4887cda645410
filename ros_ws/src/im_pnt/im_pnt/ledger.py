"""The jobs of one net: what is on the tape, what is in work, and what a symbol or a reply brings to an end."""

from collections.abc import Iterable

from im_core.errors import ImError
from im_pnt.jobs import Job, Lineage
from im_pnt.tape import InputTape, ends


class Ledger:
    """Open jobs in the order of their arrival.

    Attributes:
        tape: The input tape.
        serving: Request that holds the input semaphore SI.
    """

    def __init__(self) -> None:
        self.tape = InputTape()
        self.serving: Job | None = None
        self._open: dict[Job, int] = {}
        self._count = 0

    def add(self, job: Job) -> None:
        """Enters a job."""
        self._count += 1
        self._open[job] = self._count

    def close(self, job: Job, error: ImError | None) -> None:
        """Ends a job and tells whoever waits for it."""
        self._open.pop(job, None)
        if self.serving is job:
            self.serving = None
        job.close(error)

    def __len__(self) -> int:
        return len(self._open)

    def of_command(self, command_id: int | None) -> list[Job]:
        """Returns the open jobs of a command, or all of them."""
        return [job for job in self._open if command_id is None or job.command.id == command_id]

    def of_request(self, request_id: str) -> list[Job]:
        """Returns the open jobs of a request: one or none."""
        return [job for job in self._open if job.request is not None and job.request.id == request_id]

    def begun_commands(self) -> list[Job]:
        """Returns the open commands that have been read from the tape."""
        waiting = set(self.tape.waiting())
        return [job for job in self._open if job.request is None and job not in waiting]

    def ended_by(self, emitted: str, own: Job | None) -> Job | None:
        """Returns the command that an output symbol ends: that of the firing, or the oldest begun with its symbol."""
        commands = [job for job in self.begun_commands() if ends(emitted, job.command.symbol) is not None]
        if own is not None and own in commands:
            return own
        return commands[0] if commands else None

    def merge(self, lineages: Iterable[Lineage]) -> Lineage:
        """Makes one lineage of several: the open job that arrived last, and the first failure."""
        job: Job | None = None
        failure: ImError | None = None
        for lineage in lineages:
            failure = failure or lineage.failure
            candidate = lineage.job
            if candidate in self._open and (job is None or self._open[candidate] > self._open[job]):
                job = candidate
        return Lineage(job or self.serving, failure)
