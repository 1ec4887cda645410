"""What can go wrong with nets."""

import difflib
from collections.abc import Iterable

from im_core.errors import ImError

_LONGEST_NAME, _MOST_NAMES = 100, 30


class NetError(ImError):
    """A net that is wrong in itself, whatever file it came from."""

    def __init__(self, message: str, **facts: object) -> None:
        super().__init__(message, code="net", **facts)


class NetFileError(ImError):
    """A net file that cannot be read; the message starts with ``file:line``, and the column where it is known."""

    def __init__(self, file: str, line: int, message: str, column: int | None = None, **facts: object) -> None:
        where = f"{file}:{line}" if column is None else f"{file}:{line}:{column}"
        super().__init__(f"{where}: {message}", code="net_file", file=file, line=line, column=column, **facts)


class VerificationError(ImError):
    """A net that was read but must not run; carries the firing sequence that shows why."""

    def __init__(self, net: str, reason: str, sequence: Iterable[str] = ()) -> None:
        self.sequence = tuple(sequence)
        way = f"; shown by firing {' -> '.join(self.sequence)}" if self.sequence else ""
        super().__init__(
            f"net {net} is refused: {reason}{way}", code="net_refused", net=net, sequence=list(self.sequence)
        )


def nearest(name: str, known: Iterable[str]) -> str:
    """Says what may have been meant: `` (did you mean 'x'?)``, or the known names where none is near.

    Args:
        name: The name that was not found.
        known: The names that exist.

    Returns:
        Text to append to a message, empty where nothing is known.
    """
    names = sorted(set(known))
    short = [each for each in names if len(each) <= _LONGEST_NAME] if len(name) <= _LONGEST_NAME else []
    close = difflib.get_close_matches(name, short, n=1, cutoff=0.6)
    if close:
        return f" (did you mean '{close[0]}'?)"
    listed = names if len(names) <= _MOST_NAMES else [*names[:_MOST_NAMES], "..."]
    return f" (known: {', '.join(listed)})" if names else ""
