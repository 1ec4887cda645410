"""The growing net of several flattened nets."""

from collections.abc import Mapping
from dataclasses import replace

from im_pnt.errors import NetError
from im_pnt.model.net import Arcs, Net, Place, Role, Transition

NOT_LOOKED_AT = "not looked at: "
"""Begins the assumptions by which a proof knows less than the nets say; the first lines of a verdict have them."""


class FlatNet:
    """Places and transitions of several nets and the environment.

    Attributes:
        nets: The expanded nets by name.
        places: Places by qualified name.
        transitions: Transitions by qualified name.
        external: Transitions that wait for something from outside.
        rest: Places that may hold tokens at rest.
        net_of: For each place the net it belongs to, or that it surrounds.
        assumptions: What is taken for granted, in order.
    """

    def __init__(self, nets: Mapping[str, Net]) -> None:
        self.nets = nets
        self.places: dict[str, Place] = {}
        self.transitions: dict[str, Transition] = {}
        self.external: set[str] = set()
        self.rest: set[str] = set()
        self.net_of: dict[str, str] = {}
        self.assumptions: dict[str, None] = {}
        self._underway: set[str] = set()

    def qualified(self, net: str, name: str) -> str:
        """Qualify a name where there are several nets."""
        return f"{net}.{name}" if len(self.nets) > 1 else name

    def arcs(self, net: str, arcs: Arcs) -> dict[str, int]:
        """Qualify the places of arcs."""
        return {self.qualified(net, place): weight for place, weight in arcs.items()}

    def add_place(self, net: str, place: Place) -> None:
        """Add a place by the qualified name.

        Raises:
            NetError: There is one of that name.
        """
        if place.name in self.places:
            raise NetError(
                f"two places are called {place.name} where the nets are put together "
                f"(nets {self.net_of[place.name]} and {net}); rename one of them",
                place=place.name,
            )
        self.places[place.name] = place
        self.net_of[place.name] = net

    def add_transition(self, transition: Transition) -> None:
        """Add a transition by the qualified name.

        Raises:
            NetError: There is one of that name.
        """
        if transition.name in self.transitions:
            raise NetError(
                f"two transitions are called {transition.name} where the nets are put together; rename one of them",
                transition=transition.name,
            )
        self.transitions[transition.name] = transition

    def add_environment(self, transition: Transition) -> None:
        """Add a transition for an event outside."""
        self.add_transition(replace(transition, role=Role.ENVIRONMENT))
        self.external.add(transition.name)

    def underway(self, net: str, place: str) -> str:
        """Return the place of tokens under way to a place of another net."""
        target, name = self.qualified(net, place), self.underway_name(net, place)
        if name not in self._underway:
            self._underway.add(name)
            self.add_place(net, Place(name))
            arrival = self.qualified(net, f"arrive.{place}")
            self.add_transition(
                Transition(arrival, inputs={name: 1}, outputs={target: 1}, role=Role.ENVIRONMENT, origin=place)
            )
        return name

    def underway_name(self, net: str, place: str) -> str:
        """Return the name of the place of tokens under way to a place, with or without any."""
        return f"{self.qualified(net, place)}.underway"

    def assume(self, text: str) -> None:
        """Note an assumption."""
        self.assumptions[text] = None
