"""Record of the local host in a machine over several hosts: folder of the tasks, and reach of DDS for clients."""

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from im_core import names
from im_core.errors import LinkError
from im_core.files import MEBIBYTE, FileError, read_bytes, write_whole
from im_core.ownership import is_own
from im_core.processes.procfs import ProcessId
from im_core.shm_names import SHM

PROFILE = "FASTRTPS_DEFAULT_PROFILES_FILE"
"""Environment variable that names the Fast DDS profile."""
PROFILES = LOOPBACK_PROFILE, OPEN_PROFILE = "fastdds.xml", "fastdds_hosts.xml"
"""File names of our profiles, for one host and for several; a file of another name is the user's."""


@dataclass(frozen=True)
class HostRecord:
    """Facts from the bootstrap or the agent of a host for other programs of the host.

    Attributes:
        pid: Process of the bootstrap or the agent.
        start: Its start time, so that a reused pid is not taken for it [clock ticks].
        host: Name of the host in the deployment.
        is_agent: Whether the process is an agent.
        run_dir: Folder of the tasks of the host.
        dds: Environment variables by which DDS reaches the other hosts.
    """

    pid: int
    start: int
    host: str
    is_agent: bool
    run_dir: str
    dds: dict[str, str]

    @property
    def process(self) -> ProcessId:
        """The bootstrap or the agent."""
        return ProcessId(self.pid, self.start)


def write(host: str, is_agent: bool, run_dir: Path, dds: Mapping[str, str]) -> None:
    """Write the record of this host, for the calling process; arguments as of :class:`HostRecord`.

    Raises:
        LinkError: There is a file of another user.
        StoreError: It cannot be written.
    """
    me = ProcessId.current()
    record = HostRecord(me.pid, me.start, host, is_agent, str(run_dir), dict(dds))
    write_whole(_path(names.instance()), json.dumps(asdict(record)), own=True)


def read(domain: int | None = None) -> HostRecord | None:
    """Return the record of this host; None where no machine over several hosts has a living process here.

    Args:
        domain: ROS domain of the machine; None: that of the environment.
    """
    path = _path(names.instance() if domain is None else f"im{domain}")
    if not is_own(path):
        return None
    try:
        record = HostRecord(**json.loads(read_bytes(path, MEBIBYTE, own=True)))
        return record if record.process.alive() else None
    except (FileError, LinkError, ValueError, TypeError):  # no bootstrap or agent has written it
        return None


def remove() -> None:
    """Remove the record of this host if the calling process has written it."""
    record = read()
    if record is not None and record.pid == os.getpid():
        _path(names.instance()).unlink(missing_ok=True)


def reach_machine(domain: int | None = None) -> None:
    """Extend the reach of DDS in the process to all hosts of the machine on the local host; keep a profile of the user.

    Args:
        domain: As of :func:`read`.
    """
    record = read(domain)
    if record is not None and Path(os.environ.get(PROFILE, "")).name in ("", *PROFILES):
        os.environ.update(record.dds)


def _path(instance: str) -> Path:
    return SHM / f"{instance}_host.json"
