"""The jobs of one net: what is on the tape, what is in work, and what a symbol or a reply brings to an end."""

from collections.abc import Iterable

from im_core.errors import ImError
from im_pnt.jobs import NO_LINEAGE, Job, Lineage
from im_pnt.tape import InputTape, ends


class Ledger:
    """Open jobs in the order of their arrival.

    Attributes:
        tape: The input tape.
        serving: Request that holds the input semaphore SI.
        count: Jobs entered so far; the number of the last one.
    """

    def __init__(self) -> None:
        self.tape = InputTape()
        self.serving: Job | None = None
        self.count = 0
        self._open: dict[int, Job] = {}

    def add(self, job: Job) -> None:
        """Enters a job and numbers it."""
        self.count += 1
        job.number = self.count
        self._open[job.number] = job

    def reopen(self, job: Job) -> None:
        """Enters a job under the number that it has."""
        self._open[job.number] = job

    def close(self, job: Job, error: ImError | None) -> None:
        """Ends a job and tells whoever waits for it."""
        self._open.pop(job.number, None)
        if self.serving is job:
            self.serving = None
        job.close(error)

    def __len__(self) -> int:
        return len(self._open)

    def is_open(self, job: Job) -> bool:
        """Whether a job has not ended."""
        return job.number in self._open

    def jobs(self) -> list[Job]:
        """Returns the open jobs in the order of their arrival."""
        return list(self._open.values())

    def job(self, number: int) -> Job | None:
        """Returns an open job by its number."""
        return self._open.get(number)

    def of_command(self, command_id: int | None) -> list[Job]:
        """Returns the open jobs of a command of this net's own tape, or all jobs."""
        jobs = self._open.values()
        return [job for job in jobs if command_id is None or (job.request is None and job.command.id == command_id)]

    def of_request(self, request_id: str) -> list[Job]:
        """Returns the open jobs of a request: one or none."""
        return [job for job in self._open.values() if job.request is not None and job.request.id == request_id]

    def begun_commands(self) -> list[Job]:
        """Returns the open jobs that have been read from the tape."""
        return [job for job in self._open.values() if job.from_tape and not job.waiting]

    def ended_by(self, emitted: str, own: Job | None) -> Job | None:
        """Returns the job that an output symbol ends: that of the firing, or the oldest begun with its symbol."""
        if own is not None and own.from_tape and self.is_open(own) and ends(emitted, own.symbol) is not None:
            return own
        return next((job for job in self.begun_commands() if ends(emitted, job.symbol) is not None), None)

    def merge(self, lineages: Iterable[Lineage]) -> Lineage:
        """Makes one lineage of several: the open job that arrived last, and the first failure."""
        job: Job | None = None
        failure: ImError | None = None
        for lineage in lineages:
            failure = failure or lineage.failure
            own = lineage.job
            if own is not None and own.number in self._open and (job is None or own.number > job.number):
                job = own
        if job is None:
            job = self.serving
        return NO_LINEAGE if job is None and failure is None else Lineage(job, failure)
