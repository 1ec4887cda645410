"""Base of all ports."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar

from std_srvs.srv import Trigger

from im_core.errors import ImError
from im_core.ros.messages.status import ok_status, to_status
from im_vss.rig import Rig


class Port(ABC):
    """The ROS side of a Service: translates, decides nothing."""

    kind: ClassVar[type]

    def __init__(self, rig: Rig) -> None:
        """Translate for Services on `rig`."""
        self.rig = rig

    @abstractmethod
    def request(self, message: Any) -> Any:
        """The Service's request.

        Raises:
            ImError: The message holds what no request can hold.
        """

    @abstractmethod
    def answer(self, result: Any, response: Any) -> None:
        """Fill a response from the Service's result."""

    def succeed(self, response: Any, remarks: Sequence[str]) -> None:
        """Mark a response as the answer of a finished request; remarks join the one in the status."""
        response.success = True
        response.status = ok_status("; ".join(filter(None, (response.status.message, *remarks))))

    def refuse(self, error: ImError, response: Any) -> None:
        """Write an error into a response."""
        response.status = to_status(error)


class TriggerPort(Port):
    """Port of Services without arguments and with a sentence as answer: `std_srvs/srv/Trigger`."""

    kind: ClassVar[type] = Trigger

    def request(self, message: Trigger.Request) -> None:
        """There is nothing to ask."""

    def answer(self, result: str, response: Trigger.Response) -> None:
        """The sentence."""
        response.message = result

    def succeed(self, response: Trigger.Response, remarks: Sequence[str]) -> None:
        """Mark success."""
        response.success = True
        response.message = "; ".join((response.message, *remarks))

    def refuse(self, error: ImError, response: Trigger.Response) -> None:
        """Write an error into a response."""
        response.message = error.message
