"""What can go wrong with a journal."""

from im_core.errors import ImError


class JournalError(ImError):
    """A journal that cannot be read, written, or used with these nets; nothing was started.

    Args:
        message: One sentence.
        file: The file, or the folder.
        **facts: Byte offset, record number, or what else the message speaks of.
    """

    default_code = "journal"

    def __init__(self, message: str, *, file: str, **facts: object) -> None:
        super().__init__(message)
        self.facts.update(file=file, **facts)
