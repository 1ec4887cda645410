"""Names by which the parts of one machine on one host find each other."""

import os
import sys
from pathlib import Path

from im_core.errors import LinkError, StoreError, require_text
from im_core.files import make_folder
from im_core.ownership import make_private

#: Environment variables: the name of this run of the machine, which a start gives it and restarts within it keep; and,
#: where it is not empty, that whoever started it wants its unfinished commands to go on.
RUN, RESUMES = "IM_RUN", "IM_RESUMES"


#: Environment variable: the file of the cell, for every process of a machine; the shipped one where it is not set.
CELL = "IM_CELL"
#: Environment variable: a file of free bodies for the cell; none where it is not set.
OBJECTS = "IM_OBJECTS"


def instance() -> str:
    """Prefix of every shared memory and semaphore name.

    Two machines on one host differ in their ``ROS_DOMAIN_ID``, hence in this name.
    """
    return f"im{os.environ.get('ROS_DOMAIN_ID') or '0'}"


#: Files in the run folder: one names the folder of the calibration in use, the other says why the machine was stopped.
CALIBRATION, ESTOP = "calibration", "estop"


def run_dir() -> Path:
    """Return the machine's folder of logs, journals, databases and sockets; made if missing, for the user alone.

    Raises:
        StoreError: It cannot be made, belongs to another user, or may be written by other users.
        DataError: No message can carry its name.
    """
    folder = _folder("IM_RUN_DIR", Path.cwd() / ".run" / instance(), 0o700)
    try:
        if tightened := make_private(folder, "set another IM_RUN_DIR"):
            print(tightened, file=sys.stderr)
    except LinkError as error:
        raise StoreError(error.message, file=str(folder), reason="open to other users") from None
    except OSError as error:
        raise StoreError.of("looked at", folder, error) from error
    return folder


def display_file() -> Path:
    """Return the file with the address of the page, present while the page is served.

    Raises:
        StoreError: The folder for it cannot be made.
    """
    return run_dir() / "pnt_display.url"


def results_dir() -> Path:
    """Folder for the results of commands; made if missing.

    Raises:
        StoreError: It cannot be made.
        DataError: No message can carry its name.
    """
    return _folder("IM_RESULTS_DIR", Path.cwd() / "results")


def cache_dir() -> Path:
    """Return the user's folder for recomputable data, ``$XDG_CACHE_HOME/im``; created if missing.

    Raises:
        StoreError: It cannot be made.
        DataError: No message can carry its name.
    """
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return _folder("IM_CACHE_DIR", Path(home) / "im")


def _folder(variable: str, default: Path, mode: int = 0o777) -> Path:
    return make_folder(Path(require_text(os.environ.get(variable) or str(default), f"the folder {variable}")), mode)
