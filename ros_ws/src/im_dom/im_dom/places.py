"""Which places of nets there are: an object for one that does not exist would never lose its validity with a token."""

import pydantic

from im_core.arrivals import read_json
from im_core.errors import NotFoundError


class _Told(pydantic.BaseModel):
    """What is read of the description of a net."""

    places: list[str]


class Places:
    """The places of the nets that nodes describe on ``/pnt/nets``."""

    def __init__(self) -> None:
        self._of_net: dict[str, frozenset[str]] = {}

    def describe(self, net: str, text: str) -> frozenset[str]:
        """Takes the description of a net, in place of the one before.

        Args:
            net: Its name.
            text: JSON; empty: the net has gone.

        Returns:
            The places that it has now.

        Raises:
            DataError: It is no description.
        """
        if not text:
            self._of_net.pop(net, None)
            return frozenset()
        self._of_net[net] = frozenset(read_json(_Told, text, f"the description of net {net}").places)
        return self._of_net[net]

    def of(self, net: str) -> frozenset[str]:
        """The places that a net has now; none if it is not known."""
        return self._of_net.get(net, frozenset())

    def require(self, place: str) -> None:
        """Make sure that a place exists.

        Args:
            place: ``net.place``.

        Raises:
            NotFoundError: It does not; the message names the nearest that does.
        """
        net, _, name = place.partition(".")
        if net not in self._of_net:
            raise NotFoundError(kind="net", name=net, known=self._of_net)
        if name not in self._of_net[net]:
            raise NotFoundError(kind=f"place of net {net}", name=name, known=self._of_net[net])
