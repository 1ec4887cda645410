"""Endpoints of actions; a name of ROS has one type in a node."""

from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

from im_pnt.errors import NetError
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net

T = TypeVar("T")


class EndpointGoesError(NetError):
    """Signal: the endpoint of a name has another type and goes now; make a new one in a later turn of the loop."""


class Endpoints(Generic[T]):
    """Clients, publishers or subscriptions by name.

    The middleware takes no second type of a name in one process: what was made for a net that has gone makes room. It
    is gone when the executor has taken notice.

    Args:
        make: Makes one, given name and type.
        destroy: Destroys one.
    """

    def __init__(self, make: Callable[[str, str], T], destroy: Callable[[T], object]) -> None:
        self._make, self._destroy = make, destroy
        self._made: dict[str, tuple[str, T]] = {}

    def of(self, name: str, type_name: str) -> T:
        """Return the endpoint of a name, of the given type.

        Raises:
            NotFoundError: No such type is installed.
            EndpointGoesError: It is of another type, and has been destroyed.
        """
        if name not in self._made:
            self._made[name] = type_name, self._make(name, type_name)
        kind, made = self._made[name]
        if kind != type_name:
            del self._made[name]
            self._destroy(made)
            raise EndpointGoesError(f"{name} was of type {kind} and is to be of type {type_name}", name=name)
        return made


def require_one_type(net: Net, others: Iterable[Net]) -> None:
    """Check whether a net, with the neighbours in the node, uses each name of ROS with one type.

    Raises:
        NetError: It does not.
    """
    known: dict[tuple[str, str], tuple[str, str]] = {}
    for each in (*others, net):
        for transition in each.transitions.values():
            action = transition.action
            if isinstance(action, ServiceAction | GoalAction | TopicAction | AwaitAction):
                kind = action.type.split("/")[1]
                first, where = known.setdefault((kind, action.name), (action.type, f"{each.name}.{transition.name}"))
                if first != action.type:
                    text = (
                        f"{each.name}.{transition.name} says that {action.name} is of type {action.type}, and {where}"
                    )
                    raise NetError(f"{text} that it is of type {first}", net=net.name, name=action.name)
