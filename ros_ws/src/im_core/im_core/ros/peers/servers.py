"""Servers of a service or an action: if two nodes serve one name, either one may answer."""

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from im_core.errors import ImError
from im_core.ros.failures import few

#: How DDS names the topic of requests; of an action it is that of its goals.
_REQUESTS = ("rq{}Request", "rq{}/_action/send_goalRequest")


def servers_of(node: Node, name: str) -> list[str]:
    """Find the nodes serving a name, as known to the ROS graph now.

    Args:
        node: Whose view of the graph is asked.
        name: Full name of a service or of an action.

    Returns:
        Full names of nodes, sorted; a name is there twice where two nodes have it, or one node serves twice.
    """
    ends = [end for topic in _REQUESTS for end in node.get_subscriptions_info_by_topic(topic.format(name), True)]
    return sorted(map(node_of, ends))


def node_of(end: TopicEndpointInfo) -> str:
    """Return the full name of the node of a publisher or subscription."""
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"


def doubt(node: Node, name: str) -> str:
    """Describe a possible answer by a stranger: a clause, empty if all servers of a name share one node name.

    A node that was killed stays in the graph for the lease of DDS, beside the one that was started in its place.
    """
    servers = servers_of(node, name)
    if len(set(servers)) < 2:
        return ""
    return f"the answering node is unknown: {len(servers)} nodes serve {name}: {few(servers)}"


def reason(node: Node, words: str, name: str) -> str:
    """Complete the failure reason given by a server: never empty, with the names of all servers."""
    parts = (words or f"the server of {name} gave no reason", doubt(node, name))
    return "; ".join(part for part in parts if part)


def doubted(node: Node, error: ImError, name: str) -> ImError:
    """Return the error from a server's answer, with the names of all servers."""
    clause = doubt(node, name)
    return ImError.restored(error.code, f"{error.message}; {clause}", error.facts) if clause else error
