"""An emergency stop that somebody asked for, kept in the run folder until it is reset: it outlives who was asked."""

from pathlib import Path

from im_core import names
from im_core.files import FileError, read_text, synchronise_names, write_whole


class StopMark:
    """The file that says why the machine was stopped."""

    @property
    def path(self) -> Path:
        """The file."""
        return names.run_dir() / names.ESTOP

    def read(self) -> str:
        """Why the machine was stopped; empty: it was not. A file that cannot be read says that it was."""
        if not self.path.exists():
            return ""
        try:
            return read_text(self.path).strip() or "an emergency stop"
        except FileError as error:
            return f"an emergency stop whose cause cannot be read: {error.sentence}"

    def set(self, cause: str) -> None:
        """Keeps an emergency stop; one that is kept already stays.

        Raises:
            StoreError: It cannot be written.
        """
        if not self.path.exists():
            write_whole(self.path, f"{cause}\n")

    def clear(self) -> None:
        """Forgets it.

        Raises:
            OSError: The file cannot be removed.
        """
        if self.path.exists():
            self.path.unlink()
            synchronise_names(self.path.parent)
