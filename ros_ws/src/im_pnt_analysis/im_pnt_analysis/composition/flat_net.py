"""The net into which several nets are flattened, while it grows."""

from collections.abc import Mapping
from dataclasses import replace

from im_pnt.errors import NetError
from im_pnt.model.net import Arcs, Net, Place, Role, Transition


class FlatNet:
    """Places and transitions of several nets and of what surrounds them.

    Args:
        nets: The expanded nets by name.

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
        """Qualifies a name where there are several nets."""
        return f"{net}.{name}" if len(self.nets) > 1 else name

    def arcs(self, net: str, arcs: Arcs) -> dict[str, int]:
        """Qualifies the places of arcs."""
        return {self.qualified(net, place): weight for place, weight in arcs.items()}

    def add_place(self, net: str, place: Place) -> None:
        """Adds a place by its qualified name.

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
        """Adds a transition by its qualified name.

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
        """Adds a transition that fires when something outside happens."""
        self.add_transition(replace(transition, role=Role.ENVIRONMENT))
        self.external.add(transition.name)

    def underway(self, net: str, place: str) -> str:
        """Returns the place where tokens for a place of another net are on their way to it."""
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
        """Returns the name of the place where tokens for a place are on their way, whether there are any or not."""
        return f"{self.qualified(net, place)}.underway"

    def assume(self, text: str) -> None:
        """Notes what is taken for granted."""
        self.assumptions[text] = None
