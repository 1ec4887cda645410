"""What became of an action that is in doubt: answers to that question."""

import enum
from dataclasses import dataclass, field

from im_core.errors import ImError


class Verdict(enum.Enum):
    """What became of an action."""

    DONE = "done"
    FAILED = "failed"
    RUNNING = "running"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of an action.

    Attributes:
        verdict: In a word.
        error: Why it failed, where it did.
        results: Results of a request that is done.
        asked: Who or what gave the answer, or why nobody could, for people.
    """

    verdict: Verdict
    error: ImError | None = None
    results: dict[str, object] = field(default_factory=dict)
    asked: str = ""
