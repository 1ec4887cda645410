"""Types of the endpoints of actions: a name of ROS has one in a node."""

from collections.abc import Iterable, Iterator
from dataclasses import replace

from im_pnt.errors import NetError
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net, Transition
from im_pnt.model.resource_use import possible, values_of

RosAction = ServiceAction | GoalAction | TopicAction | AwaitAction
"""Action with an endpoint in ROS: a client, a publisher or a subscription."""


class EndpointGoesError(NetError):
    """Signal: the endpoint of a name has another type and goes now; make a new one in a later turn of the loop."""


def addressed(net: Net, transition: Transition) -> Iterator[RosAction]:
    """Yield the action of a transition with each name that arguments may choose.

    Raises:
        NetError: An argument in the name has no choices.
    """
    action = transition.action
    if not isinstance(action, RosAction):
        return
    if not isinstance(action, GoalAction):
        yield action
        return
    values: dict[str, frozenset[str] | None] = {}
    for schema in (*(c.arguments for c in net.commands.values()), *(s.arguments for s in net.services.values())):
        for name, texts in values_of(schema).items():
            known = values.get(name, frozenset())
            values[name] = None if texts is None or known is None else known | texts
    names = possible(action.name, values)
    if names is None:
        text = f"{net.name}.{transition.name}: {action}: what chooses a name is to be an argument with `choices`"
        raise NetError(text, net=net.name, name=action.name)
    for name in sorted(names):
        yield replace(action, name=name)


def require_one_type(net: Net, others: Iterable[Net]) -> None:
    """Check whether a net, with the neighbours in the node, uses each name of ROS with one type.

    Raises:
        NetError: It does not.
    """
    known: dict[tuple[str, str], tuple[str, str]] = {}
    for each in (*others, net):
        for transition in each.transitions.values():
            for action in addressed(each, transition):
                kind = action.type.split("/")[1]
                first, where = known.setdefault((kind, action.name), (action.type, f"{each.name}.{transition.name}"))
                if first != action.type:
                    text = (
                        f"{each.name}.{transition.name} says that {action.name} is of type {action.type}, and {where}"
                    )
                    raise NetError(f"{text} that it is of type {first}", net=net.name, name=action.name)
