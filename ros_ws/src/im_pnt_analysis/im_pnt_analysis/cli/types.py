"""Values of nets against the types of ROS messages, where ROS is installed: the check of a node at load time."""

from collections.abc import Sequence

from im_pnt.expression.scope import check_net
from im_pnt.expression.types import MessageTypes
from im_pnt.model.action import AwaitAction, GoalAction, ServiceAction, TopicAction
from im_pnt.model.net import Net
from im_pnt_analysis.cli.extensions import extensions


def checked_types(nets: Sequence[Net]) -> str:
    """Check the values in requests, objects and guards of nets.

    Args:
        nets: The nets as written.

    Returns:
        What was done, in one line; empty where the nets name no types.

    Raises:
        NetFileError: A value does not fit, or there is no such type; names file, line, column and what is allowed.
    """
    kinds = (ServiceAction, GoalAction, TopicAction, AwaitAction)
    named = any(isinstance(t.action, kinds) for net in nets for t in net.transitions.values())
    if not named and not any(place.object_type for net in nets for place in net.places.values()):
        return ""
    later = "a node checks them when it loads the nets"
    try:
        makers = list(extensions("im_pnt.message_types"))
    except ModuleNotFoundError as error:
        return f"not checked: there is no ROS here ({error.name} is not found); {later}"
    if not makers:
        return f"not checked: the package im_pnt_node is not installed; {later}"
    types: MessageTypes = makers[0]()
    for net in nets:
        check_net(net, types)
    return "values fit the types of the messages"
