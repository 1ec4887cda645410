"""Digests of everything common to the hosts of a deployment."""

import hashlib
import importlib.util
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from im_bringup.tasks.deployment import Deployment, for_cell
from im_core.files import read_bytes
from im_core.names import OBJECTS

_MESSAGES = "im_msgs"
#: Of a definition of a message [bytes].
_LARGEST = 1 << 20


def digests(deployment: Deployment) -> dict[str, str]:
    """Return the digests by name, for :func:`differences`.

    Args:
        deployment: As read from the file of the host, with all tasks or with those for its cell.

    Raises:
        ConfigError: The cell is missing or wrong, or no task can work in it.
        FileError: The file of free bodies cannot be read.
    """
    from im_cell.robot import load_cell, urdf  # half a second that starts on one host do not need

    cell = load_cell(deployment.cell or None)
    tasks = for_cell(deployment, cell.parts)  # a bootstrap has left out what the cell lacks already
    bodies = os.environ.get(OBJECTS)
    packages = {placed.task.package for placed in tasks.model_copy(update={"foxglove": 0}).tasks()}
    return {
        f"free bodies ({OBJECTS})": _digest([read_bytes(Path(bodies), _LARGEST)] if bodies else []),
        "tasks of the deployment file": _digest([tasks.model_dump_json(include={"hosts"}).encode()]),
        "cell": _digest([cell.model_dump_json(exclude={"urdf", "poses"}).encode(), urdf(cell).encode()]),
        f"messages ({_MESSAGES})": _digest(_interfaces(Path(get_package_share_directory(_MESSAGES)))),
        **{f"nets of {package}": _digest(_nets(folder)) for package in packages if (folder := _folder_of(package))},
    }


def differences(ours: Mapping[str, str], theirs: Mapping[str, str]) -> list[str]:
    """Return the names of the things on both hosts with different digests; a host may lack packages of the other."""
    return sorted(name for name in ours.keys() & theirs.keys() if ours[name] != theirs[name])


def _interfaces(share: Path) -> Iterator[bytes]:
    for path in sorted(path for kind in ("msg", "srv", "action") for path in share.glob(f"{kind}/*.{kind}")):
        yield path.name.encode()
        yield read_bytes(path, _LARGEST)


def _folder_of(package: str) -> Path | None:
    """Return the folder of a Python package; None if the host lacks the package."""
    spec = importlib.util.find_spec(package)
    return Path(spec.origin).parent if spec is not None and spec.origin else None


def _nets(folder: Path) -> Iterator[bytes]:
    for path in sorted(folder.glob("nets/**/*.yaml")):
        yield str(path.relative_to(folder)).encode()
        yield read_bytes(path, _LARGEST)


def _digest(parts: "Iterator[bytes] | list[bytes]") -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(hashlib.sha256(part).digest())
    return digest.hexdigest()
