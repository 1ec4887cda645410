"""Queue of commands for occupied resources, and the order.

A command begins when all that it needs is free, and nobody before it in the line waits for any of that. What comes
first has the smaller ``number - 10 * priority``, where commands are numbered as they come: a step of priority is worth
ten places. So nobody is starved: a command that comes more than ten times the difference of priorities later is behind,
for ever, and all that is before a command begins, and ends, before it has to wait for it again.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

from im_core.errors import StateError
from im_dispatcher.cell.needs import Needs, Variant
from im_dispatcher.cell.net import turn_of
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import GuardFunction
from im_pnt.execution.jobs import Command

PLACES = 10
"""Places in the line that a step of priority is worth."""

LEAST, MOST = -10, 10
"""Priorities that a command may have."""


class Claim(NamedTuple):
    """Command with the resources."""

    command: Command
    variant: Variant

    @property
    def rank(self) -> tuple[int, int]:
        """Rank of the command; the smallest goes first."""
        priority = max(LEAST, min(MOST, self.command.priority))
        return self.command.id - PLACES * priority, self.command.id

    def shares(self, other: "Claim") -> list[str]:
        """Return the common resources of two commands."""
        return [need for need in self.variant.needs if need in other.variant.needs]


def its_turn(asking: Claim, waiting: Iterable[Claim]) -> bool:
    """Return whether no earlier command in the queue needs any of the same resources."""
    return not any(other.rank < asking.rank and asking.shares(other) for other in waiting)


class WaitingLine:
    """Queue of the open commands of the net ``cell``.

    Args:
        needs: What its commands take.
        executor: The net in execution; looked for anew each time.
    """

    def __init__(self, needs: Needs, executor: Callable[[], Executor]) -> None:
        self._needs, self._executor = needs, executor

    def waiting(self) -> list[Claim]:
        """Return the waiting commands without the paused ones, the next first."""
        rule = self._executor().rule
        jobs = [job for job in rule.ledger.tape.waiting() if not rule.is_held(job)]
        return sorted((self.claim(job.command) for job in jobs), key=lambda claim: claim.rank)

    def coming(self) -> list[Claim]:
        """Return the commands just written: taken by the net in the next turn."""
        return [self.claim(job.command) for job in self._executor().coming()]

    def running(self) -> list[Claim]:
        """Return the running commands."""
        return [self.claim(job.command) for job in self._executor().jobs() if not job.waiting]

    def claim(self, command: Command) -> Claim:
        """Return the resources of a command.

        Raises:
            NetError: Its arguments were not checked.
        """
        return Claim(command, self._needs.variant(command.symbol, command.arguments))

    def require_same(self, needs: Needs) -> None:
        """Check whether the needs of the open commands are unchanged.

        Raises:
            StateError: One would need something else, or is not there any more; names it.
        """
        known = {(each.name, each.needs) for each in needs.variants.values()}
        for job in (*self._executor().jobs(), *self._executor().coming()):
            claim = self.claim(job.command)
            if (claim.variant.name, claim.variant.needs) not in known:
                symbols = {each.symbol for each in needs.variants.values()}
                then = "would need other resources" if job.symbol in symbols else "no net would know it any more"
                text = f"{job.symbol} (number {job.command.id}) has not ended: {then}"
                raise StateError(text, command=job.symbol)

    def require_taken(self, claim: Claim) -> None:
        """Check whether the net takes the resources of a command.

        Raises:
            StateError: It does not know the command, or takes something else: it was made for other nets.
        """
        symbol, begins = claim.command.symbol, self._executor().written.transitions.get(claim.variant.name)
        if begins is None or begins.inputs.keys() != set(claim.variant.needs):
            text = f"net {self._executor().net.name} does not take what {symbol} needs yet; ask again"
            raise StateError(text, command=symbol)

    def guards(self) -> dict[str, GuardFunction]:
        """Return the enabling functions of the net, by name."""

        def guard(name: str) -> GuardFunction:
            return lambda context: self.lets(name, context.command)

        return {turn_of(name): guard(name) for name in self._needs.variants}

    def lets(self, variant: str, command: Command) -> bool:
        """Return whether a command is next, and begins as the given variant."""
        asking = self.claim(command)
        return asking.variant.name == variant and its_turn(asking, self.waiting())

    def keepers(self, asking: Claim) -> list[tuple[Claim, str]]:
        """Return the commands in the way of another, with the resources, held or awaited."""
        before = [other for other in (*self.waiting(), *self.coming()) if other.rank < asking.rank]
        told = [(other, "has") for other in self.running()] + [(other, "waits for") for other in before]
        return [(other, how) for other, how in told if other.command.id != asking.command.id and asking.shares(other)]


def reason(asking: Claim, keepers: Iterable[tuple[Claim, str]]) -> str:
    """Return the obstacle of a waiting command: ``move needs an arm, which home (number 3) has``."""
    told = [
        f"{' and '.join(asking.shares(other))}, which {other.command.symbol} (number {other.command.id}) {how}"
        for other, how in keepers
    ]
    return f"{asking.command.symbol} needs {'; '.join(told)}"
