"""Mark of an emergency stop: a file of the run folder, kept until the reset, also after the MCS processes end."""

from pathlib import Path

from im_core import names
from im_core.errors import StoreError
from im_core.files import FileError, make_mark, read_text, synchronise_mark
from im_mcs.safety.stop_circuits import StopCircuits


class StopMark:
    """Mark of an emergency stop, beyond the life of the process cutting the power.

    The presence of the file is the statement, its content is the cause. Node and servo process both make it.
    """

    @property
    def path(self) -> Path:
        """Path of the file."""
        return names.run_dir() / names.ESTOP

    def read(self) -> str:
        """Read the cause of the emergency stop; empty where there is no mark."""
        if not self.path.exists():
            return ""
        try:
            return read_text(self.path).strip() or "an emergency stop"
        except FileError as error:
            return f"an emergency stop whose cause cannot be read: {error.sentence}"

    def synchronise(self) -> None:
        """Wait until the mark is safe against a loss of power; a mark cleared meanwhile needs nothing.

        Raises:
            StoreError: The disk has failed.
        """
        try:
            synchronise_mark(self.path)
        except StoreError:
            if self.path.exists():
                raise

    def clear(self) -> None:
        """Remove the mark.

        Raises:
            StoreError: The file cannot be removed.
        """
        try:
            self.path.unlink(missing_ok=True)
        except OSError as error:
            raise StoreError.of("removed", self.path, error) from error


class StopLatch(StopMark):
    """Keep an emergency stop by the mark, or by the stop circuits where there can be no mark.

    Args:
        circuits: The second way to the power; they outlive this process, too.
    """

    def __init__(self, circuits: StopCircuits) -> None:
        self._circuits = circuits

    def keep(self, cause: str) -> str:
        """Make the mark, without a wait for the disk; an existing mark, and its cause, stays.

        Where it cannot be made, cut the circuits, and return the failure as a sentence; empty otherwise.
        """
        try:
            make_mark(self.path, f"{cause}\n")
        except StoreError as error:
            return f"the emergency stop cannot be kept in the run folder: {error.message}; {self._circuits.cut()}"
        return ""
