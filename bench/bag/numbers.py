"""Whether messages of a topic are missing, by the numbers that publishers give theirs."""

from collections import Counter


class Numbers:
    """The numbers of the messages of a topic, in the order in which they were recorded.

    Each publisher counts its own, and a message does not say whose it is. So the numbers are taken as runs: a message
    goes on with a run that has come to the number before it, whichever does, or begins one. A publisher makes one run,
    and one more for each gap in its numbers; which of two publishers at the same number goes on makes no difference.
    A gap remains unseen only where another publisher has ended at just the number that is missing last.
    """

    def __init__(self) -> None:
        self._ends: Counter[int] = Counter()
        self._first = 0
        self._later = 0
        self.count = 0

    def take(self, number: int) -> None:
        """Takes the next message."""
        self.count += 1
        if self._ends[number - 1]:
            self._ends[number - 1] -= 1
        elif number == 1:
            self._first += 1
        else:
            self._later += 1
        self._ends[number] += 1

    def gaps(self, before: int, known: int) -> int:
        """How many gaps there are.

        Args:
            before: Publishers that were there when the recording began: their first number may be any.
            known: All publishers that were seen, these included. More runs that begin with 1 are of some that came and
                went unseen.
        """
        return max(0, self._later - (known - self._first if self._first <= known else before))
