"""Base of all Services."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from im_vss.managers import VisionClient
from im_vss.tools import Tool

if TYPE_CHECKING:
    from im_vss.rig import Rig


class Service(ABC):
    """A vision operation; stateless, so that any number of clients may be in it at once."""

    name: ClassVar[str]

    def __init__(self, rig: "Rig", tools: Mapping[str, Tool]) -> None:
        """Work on `rig` with `tools`, by name."""
        self.rig = rig
        self._tools = dict(tools)

    def tool(self, name: str) -> Any:
        """The Tool of that name, callable."""
        return self._tools[name]

    @abstractmethod
    def serve(self, client: VisionClient, request: Any) -> Any:
        """Carry out a request.

        Args:
            client: Who asks.
            request: The Service's own request type.

        Returns:
            The Service's own result type.

        Raises:
            ImError: It cannot be done; the message says why.
        """
