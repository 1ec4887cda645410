"""Errors of the client: each carries the sentence of the machine, and the facts of the sentence."""

import json
from collections.abc import Mapping
from typing import Any

from im_msgs.msg import Status


class MachineError(Exception):
    """Base of all errors of the client.

    Attributes:
        message: One sentence: what was wrong, where, and what is allowed.
        code: Kind of error, as in ``im_msgs/msg/Status``.
        facts: Named values of the sentence (joint, value, limit, unit, ...).
    """

    def __init__(self, message: str, code: str = "error", facts: Mapping[str, object] | None = None) -> None:
        super().__init__(message)
        self.message, self.code, self.facts = message, code, dict(facts or {})

    @classmethod
    def of(cls, status: Status) -> "MachineError":
        """Return the error told by a status."""
        return cls(status.message, status.code, {fact.key: _value(fact.value) for fact in status.facts})


class UnreachableError(MachineError):
    """Error of a wait: no machine, no server, or no answer in time; the message names the awaited event."""

    def __init__(self, message: str) -> None:
        super().__init__(message, "timeout")

    @classmethod
    def of_no_machine(cls, domain: int, timeout: float) -> "UnreachableError":
        """Return the error of a search for a machine in a ROS domain; the search took so long [s]."""
        return cls(
            f"no machine runs in ROS domain {domain}: none was heard within {timeout:g} s; scripts/start.sh starts "
            "one, docs/deployment.md says how to reach one on other computers"
        )


class CommandFailedError(MachineError):
    """Failure of a command.

    Attributes:
        symbol: Name of the command.
        number: Number of the command; 0 if the command was refused before it began.
        results: Results told in spite of the failure.
    """

    def __init__(self, symbol: str, number: int, status: Status, results: Mapping[str, object]) -> None:
        told = MachineError.of(status)
        super().__init__(str(results.get("message", told.message)), told.code, told.facts)
        self.symbol, self.number, self.results = symbol, number, dict(results)


class CommandCancelledError(CommandFailedError):
    """End of a command by a cancellation."""


def require(answer: Any, code: str = "state", **facts: object) -> Any:
    """Return the answer of a service that was carried out.

    Args:
        answer: The answer.
        code: Kind of error of an answer without a status.
        **facts: Named values of the sentence of an answer without a status.

    Raises:
        MachineError: The request was refused.
    """
    if answer.success:
        return answer
    if hasattr(answer, "status"):
        raise MachineError.of(answer.status)
    raise MachineError(answer.message, code, facts)


def _value(text: str) -> object:
    try:
        return json.loads(text)
    except ValueError:
        return text
