"""The number of the last transaction of the object store: clients remember it, and so notice an old copy."""

import re
from typing import NamedTuple, Self

from im_core.errors import DataError

_FORM = re.compile(r"([0-9a-f]{1,32}):([0-9]{1,18})")


class StoreMark(NamedTuple):
    """The identity of an object store, and the number of its last transaction.

    Attributes:
        store: Drawn when the store was made.
        number: Counts the transactions from 1.
    """

    store: str
    number: int

    def __str__(self) -> str:
        return f"{self.store}:{self.number}"

    @classmethod
    def of(cls, text: str) -> Self:
        """Return the mark that a text stands for.

        Raises:
            DataError: It stands for none.
        """
        found = _FORM.fullmatch(text)
        if found is None:
            raise DataError(f"'{text[:60]}' is no mark of an object store: IDENTITY:NUMBER", mark=text[:60])
        return cls(found[1], int(found[2]))


class SeenStore:
    """The object store as a client has seen it in the answers of ``/dom``.

    Attributes:
        mark: Identity and highest number; None: no answer was seen yet.
    """

    def __init__(self) -> None:
        self.mark: StoreMark | None = None

    def see(self, answered: StoreMark, before: StoreMark | None) -> str:
        """Take the mark of an answer; a store that has lost transactions is the one to compare with from then on.

        Answers may overtake each other: the store must have what was seen before the request was sent, no more.

        Args:
            answered: The mark that the answer has.
            before: The mark that was remembered when the request was sent.

        Returns:
            What the store has lost, a sentence; empty: nothing, or it is said already.
        """
        lost = _loss(before, answered) and _loss(self.mark, answered)
        known = self.mark
        if lost or known is None or (answered.store == known.store and answered.number > known.number):
            self.mark = answered
        return lost


def _loss(before: StoreMark | None, now: StoreMark) -> str:
    if before is None:
        return ""
    if now.store != before.store:
        return "the object store of /dom is not the one that it was: what was put into that one is lost"
    if now.number >= before.number:
        return ""
    return (
        f"the object store of /dom is an old copy: its last transaction is {now.number}, {before.number} was "
        "acknowledged before; what was changed since is lost"
    )
