"""Errors of nets."""

import json
from collections.abc import Iterable

from im_core.errors import ImError


class NetError(ImError):
    """Net with an internal fault, from any file."""

    def __init__(self, message: str, **facts: object) -> None:
        super().__init__(message, code="net", **facts)


class NetFileError(ImError):
    """Unreadable net file; the message starts with ``file:line``, and the column where known."""

    def __init__(self, file: str, line: int, message: str, column: int | None = None, **facts: object) -> None:
        where = f"{file}:{line}" if column is None else f"{file}:{line}:{column}"
        super().__init__(f"{where}: {message}", code="net_file", file=file, line=line, column=column, **facts)


class MissingPartsError(NetFileError):
    """Net file that needs more of something than there is, as of arms or lights; the net is sound elsewhere."""


_UNPROVED_HINT = (
    "; 'scripts/im pnt verify --timeout S' takes more time to prove it, 'start --unproved' starts it all the same"
)


class VerificationError(ImError):
    """Readable net not allowed to run.

    Args:
        net: Its name, or those of several nets.
        reason: Why, or what is not known of it.
        sequence: The firings that show why; empty where there are none.
        proved: Whether it was found that it must not run; else it could not be decided.
    """

    def __init__(self, net: str, reason: str, sequence: Iterable[str] = (), *, proved: bool = True) -> None:
        self.sequence = tuple(sequence)
        way = f"; shown by firing {' -> '.join(self.sequence)}" if self.sequence else ""
        verdict, hint = ("refused", "") if proved else ("not proved", _UNPROVED_HINT)
        super().__init__(
            f"net {net} is {verdict}: {reason}{way}{hint}", code="net_refused", net=net, sequence=list(self.sequence)
        )


class JournalError(ImError):
    """Journal not readable, not writable, or not usable with the given nets; nothing was started.

    Args:
        message: One sentence.
        file: The file, or the folder.
        **facts: Byte offset, record number, or what else the message speaks of.
    """

    default_code = "journal"

    def __init__(self, message: str, *, file: str, **facts: object) -> None:
        super().__init__(message)
        self.facts.update(file=file, **facts)


class DamagedJournalError(JournalError):
    """Journal with a content not written so."""


def encode_error(error: ImError | None) -> list[object] | None:
    """Write an error as JSON data; other facts, also infinite numbers, are written as text."""
    if error is None:
        return None
    facts: object = json.loads(json.dumps(error.facts, default=str, skipkeys=True), parse_constant=str)
    return [error.code, error.message, facts]


def decode_error(content: object) -> ImError | None:
    """Read an error.

    Raises:
        ValueError: It is none.
    """
    match content:
        case None:
            return None
        case [str(code), str(message), dict(facts)]:
            return ImError.restored(code, message, facts)
    raise ValueError(f"{str(content)[:200]} is no error")
