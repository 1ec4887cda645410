"""Checks of the local host before any start: free space, open files, writable folders, discovery of nodes."""

import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from im_core import files, names
from im_core.errors import ImError, StoreError
from im_core.shm_names import SHM

# Counted on the machine of the default deployment, 11 processes, while it ran a command.
#: Most that any process has open is 29; the page of the display has up to 150 connections more, and as they come 32.
OPEN_FILES = 256
#: Blocks of servo, cameras and testbed are 9.7 MB in shared memory; logs, parameters, journals and data objects 2.1 MB
#: after a command, its results 0.7 MB.
ROOM_BYTES = 16 * 2**20
#: A machine has 73 files in its folders after a command, and fewer in shared memory.
FILES = 128
#: Logs are 16 MiB before they are rotated.
FILE_BYTES = 32 * 2**20

_MIB = 2**20
_SERVER, _RMW = "ROS_DISCOVERY_SERVER", "RMW_IMPLEMENTATION"
_SECURITY = "ROS_SECURITY_ENABLE"
_MAKE_NODE = "import rclpy; rclpy.init(args=[]); rclpy.create_node('preflight')"
#: How rclpy begins the reason, and how long a busy computer may take for a node [s].
_NO_NODE, _NODE_S = "RCLError: ", 60.0
_SHM_REMEDY = "scripts/stop.sh removes the files of killed machines; a container gets more room with --shm-size"


@dataclass(frozen=True)
class Check:
    """Check of the local host, with the remedy for its fault.

    Attributes:
        name: Name of the check.
        look: Function that raises the fault.
        remedy: Clause with the remedy.
    """

    name: str
    look: Callable[[], object]
    remedy: str

    def fault(self) -> ImError | None:
        """Return the fault, with the remedy; None without a fault."""
        try:
            self.look()
        except ImError as error:
            return ImError.restored(error.code, f"{error.message}; {self.remedy}", error.facts)
        return None

    def require(self) -> None:
        """Refuse to start on a host with the fault.

        Raises:
            ImError: The fault, in one sentence: found value, needed value, remedy.
        """
        if (fault := self.fault()) is not None:
            raise ImError.restored("resources", f"{fault.message}; nothing was started", fault.facts)


def host_checks() -> list[Check]:
    """Return the checks independent of a deployment."""
    folders = {"IM_RUN_DIR": names.run_dir, "IM_RESULTS_DIR": names.results_dir, "ROS_LOG_DIR": _ros_logs}
    rooms = [
        Check(f"folder {variable}", partial(_check_folder, find), f"make room, or set {variable} to another folder")
        for variable, find in folders.items()
    ]
    return [
        Check("open files", _check_open_files, "an administrator raises it in /etc/security/limits.conf"),
        Check("size of a file", _check_file_size, "'ulimit -f unlimited' lifts it"),
        *rooms,
        Check("temporary files", lambda: _check_writable(_temporary), "set TMPDIR to another folder"),
        Check("shared memory", lambda: _check_folder(lambda: SHM), _SHM_REMEDY),
        Check("discovery server", _check_discovery_server, f"'unset {_SERVER}' mends it"),
        Check("loopback interface", _check_loopback, "'sudo ip link set lo up' mends it"),
        Check("middleware", _check_middleware, f"'unset {_RMW}' mends it"),
        Check("DDS security", _check_security, f"'unset {_SECURITY}' starts without it"),
    ]


def check_host() -> None:
    """Check the local host for everything needed by a machine, whatever its deployment.

    Raises:
        ImError: The first fault, in one sentence.
    """
    for check in host_checks():
        check.require()


def check_folder(folder: Path) -> None:
    """Make a folder if missing, and check for write access.

    Raises:
        ImError: It cannot.
    """
    remedy = "remove it, or set IM_RUN_DIR to another folder"
    Check(f"folder {folder}", lambda: _check_writable(lambda: files.make_folder(folder)), remedy).require()


def _check_discovery_server() -> None:
    if server := os.environ.get(_SERVER):
        raise _refused(f"{_SERVER} is {server}: nodes ask only this server for each other", server=server)


def _check_loopback() -> None:
    """Send a datagram to itself over the loopback interface."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            end.bind(("127.0.0.1", 0))
            end.sendto(b"", end.getsockname())
    except OSError as error:
        sentence = f"the loopback interface does not work ({error.strerror}), over which nodes find each other"
        raise _refused(sentence, reason=error.strerror) from error


def _check_middleware() -> None:
    """Look for the library named by the environment in the index of the installed packages."""
    wanted = os.environ.get(_RMW)
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    index = [Path(prefix, "share/ament_index/resource_index/rmw_typesupport") for prefix in prefixes if prefix]
    known = {path.name for folder in index for path in folder.glob("rmw_*")} - {"rmw_implementation"}
    if wanted and wanted not in known:
        installed = ", ".join(sorted(known)) or "none"
        raise _refused(f"{_RMW} is {wanted}, which is not installed (installed: {installed})", wanted=wanted)


def _check_security() -> None:
    """Make a node in another process, if the environment asks for DDS security."""
    if os.environ.get(_SECURITY, "").lower() != "true":
        return
    argv = [sys.executable, "-P", "-c", _MAKE_NODE]
    try:
        made = subprocess.run(argv, capture_output=True, text=True, check=False, timeout=_NODE_S)
    except subprocess.TimeoutExpired:
        reason = f"waited {_NODE_S:g} s for one, in vain"
        raise _refused(f"{_SECURITY} is true, and no node can be made ({reason})", reason=reason) from None
    if made.returncode != 0:
        reason = next((line for line in made.stderr.splitlines() if _NO_NODE in line), made.stderr.strip()[-200:])
        reason = reason.partition(_NO_NODE)[2] or reason
        raise _refused(f"{_SECURITY} is true, and no node can be made ({reason})", reason=reason)


def _check_folder(find: Callable[[], Path]) -> None:
    folder = _check_writable(find)
    _check_room(folder)
    _check_files(folder)


def _check_open_files() -> None:
    """Raise the open-files limit of the process and of the machine's processes, if the system permits."""
    allowed, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if allowed != resource.RLIM_INFINITY and allowed < OPEN_FILES:
        if most != resource.RLIM_INFINITY and most < OPEN_FILES:
            sentence = f"a process may open {most} files here (ulimit -n), and up to {OPEN_FILES} are needed"
            raise _refused(sentence, limit=most, needed=OPEN_FILES)
        resource.setrlimit(resource.RLIMIT_NOFILE, (OPEN_FILES, most))


def _check_file_size() -> None:
    most = resource.getrlimit(resource.RLIMIT_FSIZE)[0]
    if most != resource.RLIM_INFINITY and most < FILE_BYTES:
        there, needed = f"{most / _MIB:.2g} MiB", f"{FILE_BYTES / _MIB:.0f} MiB"
        sentence = f"a file may have {there} here (ulimit -f), and {needed} are needed"
        raise _refused(sentence, limit=most, needed=FILE_BYTES)


def _ros_logs() -> Path:
    """Return the folder for the ROS logs of all processes; without the folder no process starts."""
    home = Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")
    return files.make_folder(Path(os.environ.get("ROS_LOG_DIR") or home / "log"))


def _temporary() -> Path:
    """Return the folder for short-lived files, for readers of files only, such as pybullet.

    Raises:
        StoreError: There is none that can be written.
    """
    try:
        return Path(tempfile.gettempdir())
    except FileNotFoundError as error:
        raise StoreError("no folder for temporary files is writable", file="/tmp", reason=str(error)) from error


def _check_writable(find: Callable[[], Path]) -> Path:
    """Write a file without a name into a folder, which is returned."""
    try:
        folder = find()  # which makes it
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(bytes(4096))
            file.flush()
            os.fsync(file.fileno())
    except StoreError as error:
        raise _refused(error.message, **error.facts) from error
    except OSError as error:
        raise _refused(f"{folder} cannot be written: {error.strerror}", folder=str(folder)) from error
    return folder


def _check_room(folder: Path) -> None:
    free = shutil.disk_usage(folder).free
    if free < ROOM_BYTES:
        there, needed = f"{free / _MIB:.0f} MiB", f"{ROOM_BYTES / _MIB:.0f} MiB"
        sentence = f"the disk of {folder} has {there} free, and {needed} are needed"
        raise _refused(sentence, free=free, needed=ROOM_BYTES)


def _check_files(folder: Path) -> None:
    told = os.statvfs(folder)
    if told.f_files and told.f_favail < FILES:  # not all file systems count them
        sentence = f"the disk of {folder} takes {told.f_favail} files more, and {FILES} are needed"
        raise _refused(sentence, free=told.f_favail, needed=FILES)


def _refused(sentence: str, **facts: object) -> ImError:
    return ImError(sentence, code="resources", **facts)
