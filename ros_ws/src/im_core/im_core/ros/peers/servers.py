"""Servers of a service or an action: if two nodes serve one name, either one may answer."""

import os

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from im_core.errors import ImError, nearest
from im_core.processes.procfs import ProcessId, has_loaded, processes_ending_in
from im_core.ros.failures import few

#: How DDS names the topic of requests; of an action it is that of its goals.
_GOALS = "/_action/send_goal"
_REQUESTS = ("rq{}Request", f"rq{{}}{_GOALS}Request")

_PARTICIPANT_BYTES, _HOST_BYTES, _PID_BYTES = 12, 4, 2
_FAST_DDS = bytes((0x01, 0x0F))
"""Vendor that the identity of a participant begins with. Its host follows, and the low bytes of its process id."""
_MOST_PARTICIPANTS = 1000
_processes: dict[bytes, ProcessId | None] = {}


def servers_of(node: Node, name: str) -> list[str]:
    """Find the nodes serving a name, as known to the ROS graph now, without those whose process has ended.

    Args:
        node: Whose view of the graph is asked.
        name: Full name of a service or of an action.

    Returns:
        Full names of nodes, sorted; a name is there twice where two nodes have it, or one node serves twice.
    """
    return sorted(map(node_of, server_ends(node, name)))


def offered_alike(node: Node, name: str) -> str:
    """Return a hint at the names of the same type that are offered, for a name without a server; empty without any."""
    known = dict(node.get_service_names_and_types())
    end = _GOALS if name + _GOALS in known else ""
    same = (each.removesuffix(end) for each, types in known.items() if types == known.get(name + end))
    return nearest(name, (each for each in same if each != name and servers_of(node, each)))


def server_ends(node: Node, name: str) -> list[TopicEndpointInfo]:
    """Find the ends of DDS that take the requests of a name; arguments as of :func:`servers_of`.

    DDS keeps the ends of a killed process for the lease of that process. One of this host and this user is left out as
    soon as its process has ended.
    """
    ends = [end for topic in _REQUESTS for end in node.get_subscriptions_info_by_topic(topic.format(name), True)]
    return [end for end in ends if (process := _process_of(node, end)) is None or not process.ended()]


def sure_to_live(node: Node, name: str) -> int:
    """Count the servers of a name whose processes are known to live; arguments as of :func:`servers_of`."""
    return sum(_process_of(node, end) is not None for end in server_ends(node, name))


def _process_of(node: Node, end: TopicEndpointInfo) -> ProcessId | None:
    """Find the process of an end when it is seen first; None on another host, of another user, or in doubt.

    A process number alone proves nothing, for the process may count in a container of its own.
    """
    participant = bytes(end.endpoint_gid[:_PARTICIPANT_BYTES])
    if participant not in _processes:
        host = _this_host(node)
        if host is None:
            return None  # the graph does not show this node yet
        if len(_processes) == _MOST_PARTICIPANTS:
            del _processes[next(iter(_processes))]
        low = int.from_bytes(participant[_HOST_BYTES : _HOST_BYTES + _PID_BYTES], "little")
        here = participant.startswith(host)
        pids = [pid for pid in processes_ending_in(low, 8 * _PID_BYTES) if has_loaded(pid, "libfast")] if here else []
        _processes[participant] = ProcessId.of(pids[0]) if len(pids) == 1 else None
    return _processes[participant]


def _this_host(node: Node) -> bytes | None:
    """Read vendor and host of this process as Fast DDS writes them into the identity of each participant."""
    mine = os.getpid().to_bytes(4, "little")[:_PID_BYTES]
    for end in node.get_publishers_info_by_topic("/parameter_events"):
        gid = bytes(end.endpoint_gid)
        own = node_of(end) == node.get_fully_qualified_name()
        if own and gid.startswith(_FAST_DDS) and gid[_HOST_BYTES : _HOST_BYTES + _PID_BYTES] == mine:
            return gid[:_HOST_BYTES]
    return None


def node_of(end: TopicEndpointInfo) -> str:
    """Return the full name of the node of a publisher or subscription."""
    return f"{end.node_namespace.rstrip('/')}/{end.node_name}"


def doubt(node: Node, name: str) -> str:
    """Describe a possible answer by a stranger: a clause, empty if all servers of a name share one node name.

    A node that was killed on another host stays in the graph for the lease of DDS, beside the one in its place.
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
