"""What can go wrong with nets."""

import difflib
from collections.abc import Iterable

from im_core.errors import ImError


class NetError(ImError):
    """A net that is wrong in itself, whatever file it came from."""

    def __init__(self, message: str, **facts: object) -> None:
        super().__init__(message, code="net", **facts)


class NetFileError(ImError):
    """A net file that cannot be read; the message starts with ``file:line``."""

    def __init__(self, file: str, line: int, message: str, **facts: object) -> None:
        super().__init__(f"{file}:{line}: {message}", code="net_file", file=file, line=line, **facts)


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
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f" (did you mean '{close[0]}'?)"
    return f" (known: {', '.join(names)})" if names else ""
