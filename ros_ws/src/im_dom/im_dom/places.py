"""Existing places of nets: an object for an unknown place would never lose the validity with a token."""

import re

import pydantic

from im_core.errors import DataError, NotFoundError, StateError
from im_core.text.bounded_json import read_json

_PLACE = re.compile(r"[A-Za-z][A-Za-z0-9_]*\.[A-Za-z][A-Za-z0-9_.]*")

#: How many nets are known.
MOST_NETS = 1000


def check_form(place: str) -> None:
    """Refuse names not possible for a place.

    Raises:
        DataError: It is not of the form ``net.place``.
    """
    if not _PLACE.fullmatch(place):
        raise DataError(f"the place of a data object '{place}' is not allowed: net.place", value=place)


class _Told(pydantic.BaseModel):
    """Read part of the description of a net."""

    places: list[str]


class Places:
    """Places of the nets described by nodes on ``/pnt/nets``."""

    def __init__(self) -> None:
        self._of_net: dict[str, frozenset[str]] = {}
        self._nodes: dict[str, str] = {}

    def describe(self, net: str, node: str, text: str) -> None:
        """Take the description of a net, in place of the one before.

        Args:
            net: Its name.
            node: The node that describes it.
            text: JSON; empty: the node does not run the net any more. Another one may have taken it over.

        Raises:
            DataError: It is no description.
            StateError: Too many others are known.
        """
        if not text:
            if self._nodes.get(net) == node:
                del self._of_net[net], self._nodes[net]
            return
        places = frozenset(read_json(_Told, text, f"the description of net {net}").places)
        if len(self._of_net) == MOST_NETS and net not in self._of_net:
            raise StateError(f"net {net} is not learned: {MOST_NETS} others are known", net=net)
        self._of_net[net], self._nodes[net] = places, node

    def __contains__(self, net: object) -> bool:
        return net in self._of_net

    def of(self, net: str) -> frozenset[str]:
        """Return the present places of a net; none for an unknown net."""
        return self._of_net.get(net, frozenset())

    def require(self, place: str) -> None:
        """Check whether a place exists.

        Args:
            place: ``net.place``.

        Raises:
            DataError: It is not of that form.
            NotFoundError: It does not; the message names the nearest that does.
        """
        check_form(place)
        net, _, name = place.partition(".")
        if net not in self._of_net:
            raise NotFoundError(kind="net", name=net, known=self._of_net)
        if name not in self._of_net[net]:
            raise NotFoundError(kind=f"place of net {net}", name=name, known=self._of_net[net])
