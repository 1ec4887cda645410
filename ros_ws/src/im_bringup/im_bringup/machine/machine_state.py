"""The record of a running machine: one file a ROS domain, written by the bootstrap, read by ``start`` and ``stop``."""

import json
import os
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from im_core import names
from im_core.errors import DataError, LinkError
from im_core.files import MEBIBYTE, FileError, read_bytes, write_whole
from im_core.ownership import is_own, require_own
from im_core.processes.procfs import ProcessId
from im_core.shm_names import SHM

STARTING, READY, FAILED, STOPPING = "starting", "ready", "failed", "stopping"


@dataclass(frozen=True)
class MachineRecord:
    """State of a running machine, known without a request to the nodes.

    Attributes:
        pid: Process of the bootstrap.
        start: Its start time, so that a reused pid is not taken for it [clock ticks].
        state: starting, ready, failed or stopping.
        phase: Start-up phase it is in.
        tasks: Number of tasks.
        missing: One sentence for each task that has not finished the phase.
        nets: The verdict on its nets; empty before, and where it has none.
        refused: Whether it is its nets for which it could not be started.
        took: How long the parts of the start have taken, in their order [s].
        run_dir: Folder of its logs.
        deployment: File it was started from.
        clock_factor: Simulated seconds a second.
        seed: Seed of the run.
        port: Port that the display was told to take; the page says which it took.
        incarnations: Those of its tasks that have reported, by name.
    """

    pid: int
    start: int
    state: str
    phase: str
    tasks: int
    run_dir: str
    deployment: str
    clock_factor: float
    seed: int
    port: int
    missing: list[str] = field(default_factory=list)
    nets: str = ""
    refused: bool = False
    took: dict[str, float] = field(default_factory=dict)
    incarnations: dict[str, int] = field(default_factory=dict)

    @property
    def process(self) -> ProcessId:
        """The bootstrap."""
        return ProcessId(self.pid, self.start)

    @property
    def alive(self) -> bool:
        """Whether the bootstrap runs."""
        return self.process.alive()


_LARGEST = MEBIBYTE
_RECORD_SUFFIX = "_machine.json"


def record_path() -> Path:
    """Return the path of the record: in shared memory, so valid for all folders until the computer restarts."""
    return SHM / f"{names.instance()}{_RECORD_SUFFIX}"


def read(path: Path | None = None) -> MachineRecord | None:
    """Read the record of the machine of the current ROS domain, None if there is none.

    Args:
        path: Another record's file.

    Raises:
        DataError: The file is not a record.
        LinkError: It belongs to another user.
    """
    import pydantic  # a sixth of the start of a client, few of which read a record

    from im_core.config import field_name

    path = path or record_path()
    if require_own(path) is None:
        return None
    try:
        record: MachineRecord = _adapter().validate_json(read_bytes(path, _LARGEST, own=True))
    except FileError as error:
        if isinstance(error.__cause__, FileNotFoundError):  # the machine has ended meanwhile
            return None
        raise DataError(f"{path} is not the record of a machine: {error.sentence}", file=str(path)) from error
    except pydantic.ValidationError as error:
        fault = error.errors(include_url=False)[0]
        sentence = f"{field_name(fault['loc']) or 'the whole'}: {fault['msg']}"
        raise DataError(f"{path} is not the record of a machine: {sentence}", file=str(path)) from error
    if record.pid <= 1 or record.start < 0:
        told = f"no machine has process {record.pid} that started at {record.start}"
        raise DataError(f"{path} is not the record of a machine: {told}", file=str(path))
    return record


@cache
def _adapter() -> Any:
    import pydantic

    return pydantic.TypeAdapter(MachineRecord)


def recorded() -> bool:
    """Return whether the local host has the record of a machine, living or dead, of the current ROS domain.

    Raises:
        LinkError: The record belongs to another user.
    """
    return require_own(record_path()) is not None


def runs_here() -> bool:
    """Whether a machine of the current ROS domain runs on the local host; raises as :func:`read`."""
    record = read()
    return record is not None and record.alive


def neighbour(run_dir: Path) -> str:
    """Return the instance of another ROS domain with a machine running in a folder; empty string if there is none.

    Whoever may write into ``/dev/shm`` may leave a file there that is no record: it is nobody's.
    """
    for path in sorted(SHM.glob(f"im*{_RECORD_SUFFIX}")):
        if path == record_path():
            continue
        with suppress(DataError, LinkError):
            record = read(path)
            if record is not None and record.alive and Path(record.run_dir).resolve() == run_dir.resolve():
                return path.name.removesuffix(_RECORD_SUFFIX)
    return ""


def write(record: MachineRecord) -> None:
    """Replace the record in one step.

    Raises:
        LinkError: There is a file of another user.
        StoreError: It cannot be written.
    """
    write_whole(record_path(), json.dumps(asdict(record)), own=True)


def remove() -> None:
    """Remove the record, unless another user owns the file."""
    if is_own(record_path()):
        record_path().unlink(missing_ok=True)


def domain() -> str:
    """Return the ROS domain of the environment."""
    return os.environ.get("ROS_DOMAIN_ID") or "0"
