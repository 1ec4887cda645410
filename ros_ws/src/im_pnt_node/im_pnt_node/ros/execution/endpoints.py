"""Types of the endpoints of actions: a name of ROS has one in a node."""

from collections.abc import Iterable

from im_pnt.errors import NetError
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net

RosAction = ServiceAction | GoalAction | TopicAction | AwaitAction
"""Action with an endpoint in ROS: a client, a publisher or a subscription."""


class EndpointGoesError(NetError):
    """Signal: the endpoint of a name has another type and goes now; make a new one in a later turn of the loop."""


def require_one_type(net: Net, others: Iterable[Net]) -> None:
    """Check whether a net, with the neighbours in the node, uses each name of ROS with one type.

    Raises:
        NetError: It does not.
    """
    known: dict[tuple[str, str], tuple[str, str]] = {}
    for each in (*others, net):
        for transition in each.transitions.values():
            action = transition.action
            if isinstance(action, RosAction):
                kind = action.type.split("/")[1]
                first, where = known.setdefault((kind, action.name), (action.type, f"{each.name}.{transition.name}"))
                if first != action.type:
                    text = (
                        f"{each.name}.{transition.name} says that {action.name} is of type {action.type}, and {where}"
                    )
                    raise NetError(f"{text} that it is of type {first}", net=net.name, name=action.name)
