"""One tree of errors; each error has facts and reads as a sentence."""

import difflib
from collections.abc import Iterable, Mapping, Sequence

#: Of the names that exist: how long and how many may be to be compared with one that does not, and how many are listed.
_LONGEST_NAME, _MOST_COMPARED, _MOST_NAMES = 60, 1000, 30
SHOWN = 60
"""Characters that an error quotes of a file: it may be answered to a process that may not read the file."""
BEGUN_ANEW = "begun_anew"
"""Code of a failure: the task that kept an establishment has a new incarnation. Nets that can establish it again look
for this code."""


class ImError(Exception):
    """Base of all errors of the machine.

    Args:
        message: One sentence that names what was wrong, where, and what is allowed.
        code: Kind of error, as in ``im_msgs/msg/Status``.
        **facts: Named values the message speaks of (joint, value, limit, unit, file, line, ...).
    """

    default_code = "error"

    def __init__(self, message: str, *, code: str | None = None, **facts: object) -> None:
        self.message = printable(message)
        super().__init__(self.message)
        self.code = code or self.default_code
        self.facts: dict[str, object] = dict(facts)

    @classmethod
    def restored(cls, code: str, message: str, facts: Mapping[str, object]) -> "ImError":
        """Return the error reported by another process."""
        error = ImError(message, code=code)
        error.facts.update(facts)
        return error


class ConfigError(ImError):
    """Forbidden content of a configuration file, parameter or net file."""

    default_code = "config"


class DataError(ImError):
    """Unusable data: wrong size, not finite, degenerate, inconsistent."""

    default_code = "data"


class ArgumentError(DataError):
    """Arguments not allowed by a schema: one is unknown, missing, or of a wrong value."""

    default_code = "argument"


class StateError(ImError):
    """Request not allowed in the present state."""

    default_code = "state"


class LinkError(ImError):
    """Another process, or the memory shared with the process, is gone or does not answer."""

    default_code = "link"


class StoreError(ImError, OSError):
    """A file cannot be written or read: the disk is full, has failed, or may not be written to.

    What the file held before is still there; the same may be tried again.

    Args:
        message: One sentence.
        file: The file or folder.
        reason: What the operating system or the library says.
        errno: Number of the operating system's error, if it is one.
    """

    default_code = "store"

    def __init__(self, message: str, *, file: str, reason: str, errno: int | None = None) -> None:
        super().__init__(message, file=file, reason=reason)
        self.errno, self.strerror, self.filename = errno, reason, file

    def __str__(self) -> str:
        return self.message

    @classmethod
    def of(cls, what: str, file: object, error: OSError) -> "StoreError":
        """The error of the operating system as one of ours.

        Args:
            what: What cannot be done with the file: ``written``, ``made``.
            file: The file or folder.
            error: Why.
        """
        reason = error.strerror or str(error)
        return cls(f"{file} cannot be {what}: {reason}", file=str(file), reason=reason, errno=error.errno)


class LimitError(ImError):
    """Value beyond a limit.

    Args:
        joint: Name of the joint or quantity.
        value: What was asked for.
        limit: What is allowed.
        unit: Unit of both.
        what: Kind of limit: position, velocity, torque, ...
    """

    default_code = "limit"

    def __init__(self, *, joint: str, value: float, limit: float, unit: str, what: str = "position") -> None:
        super().__init__(
            f"{joint}: {what} {value:.6g} {unit} is beyond the limit {limit:.6g} {unit}",
            joint=joint,
            value=value,
            limit=limit,
            unit=unit,
            what=what,
        )


class WaitTimeoutError(ImError):
    """Wait without success.

    Args:
        what: What was waited for.
        seconds: How long [s].
    """

    default_code = "timeout"

    def __init__(self, *, what: str, seconds: float) -> None:
        super().__init__(f"waited {seconds:g} s for {what}, in vain", what=what, seconds=seconds)


class NotFoundError(ImError):
    """Unknown name.

    Args:
        kind: Kind of thing, e.g. ``camera``.
        name: The name that was given.
        known: The names that exist, of which the first are listed.
        waited_s: How long the name was waited for [s]; 0: not at all.
    """

    default_code = "not_found"

    def __init__(self, *, kind: str, name: str, known: Iterable[str] = (), waited_s: float = 0.0) -> None:
        names = sorted(known)
        near = _closest(name, names)
        hint = f"; did you mean '{near}'?" if near else ""
        listed = _listed(names)
        shown = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
        waited = f" (waited {waited_s:g} s)" if waited_s else ""
        sentence = f"there is no {kind} {shown!r}{waited}{hint}{listed}"
        super().__init__(sentence, kind=kind, name=name, known=names[:_MOST_NAMES])


def printable(text: str) -> str:
    """Return a text fit for every log and message: zeros and characters outside UTF-8 are written out."""
    return text.encode("utf-8", "backslashreplace").decode().replace("\0", "\\0")


def quoted_text(text: str, most: int = SHOWN) -> str:
    """Return the beginning of a text in quotes."""
    return repr(shortened(text, most))


def shortened(text: str, most: int = SHOWN) -> str:
    """Return a text, or only the beginning followed by dots."""
    return text if len(text) <= most else f"{text[:most]}..."


def require_text(text: str, what: str) -> str:
    """Return a text fit for every message: half a character (a lone surrogate) ends a process of ROS.

    Such texts come from JSON, and as names of files and arguments that are no UTF-8.

    Raises:
        DataError: It has half a character.
    """
    try:
        text.encode()
    except UnicodeEncodeError as error:
        character = ord(text[error.start])
        words = f"{what} with U+{character:04X}, which is half a character, is not allowed"
        raise DataError(words, what=what, text=printable(text)[:200]) from error
    return text


FOREIGN = (Exception, SystemExit)
"""What code of users may raise: ``sys.exit`` ends what it was called for, not the process that called it."""


def as_exception(error: BaseException) -> Exception:
    """Convert an error raised by user code to an exception fit to be raised at the waiting caller."""
    return error if isinstance(error, Exception) else RuntimeError(f"the function called sys.exit: {error}")


def nearest(name: str, known: Iterable[str]) -> str:
    """Return a hint at the intended name: `` (did you mean 'x'?)``, or the known names without a near one.

    Returns:
        Text to append to a message, empty where nothing is known.
    """
    names = sorted(set(known))
    near = _closest(name, names)
    if near:
        return f" (did you mean '{near}'?)"
    return _listed(names)


def _listed(names: Sequence[str]) -> str:
    listed = names if len(names) <= _MOST_NAMES else [*names[:_MOST_NAMES], "..."]
    return f" (known: {', '.join(listed)})" if names else ""


def _closest(name: str, names: Sequence[str]) -> str | None:
    """Return the name probably meant; long names and long lists are skipped: the time grows with the product."""
    if len(name) > _LONGEST_NAME or len(names) > _MOST_COMPARED:
        return None
    short = [each for each in names if len(each) <= _LONGEST_NAME]
    return next(iter(difflib.get_close_matches(name, short, n=1)), None)
