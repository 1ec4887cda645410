"""``im security make``: a keystore of SROS 2 for the running machine, from its deployment and its ROS graph."""

import sys
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from rclpy.node import NodeNameNonExistentError

from im_bringup.ros.client_output import DONE
from im_bringup.ros.interfaces import DISCOVERY_AT_MOST_S, settle
from im_bringup.ros.interruptible import talk
from im_bringup.ros.tasks import WAIT_S, TasksNode
from im_bringup.security.keystore import Keystore
from im_bringup.security.permissions import (
    AGENT,
    BOOTSTRAP,
    CLIENT,
    NodeInterfaces,
    client_permissions,
    enclave_of,
    permissions_of,
)
from im_bringup.tasks.deployment import agent_name
from im_core.errors import StateError, WaitTimeoutError
from im_core.options import NumberParser
from im_core.ros.peers.servers import node_of

#: Bytes of a GUID that name the participant, which has one enclave.
_PREFIX = 12


class GraphNode(TasksNode):
    """Client that reads the registry of tasks, and what the nodes of each process offer."""

    def interfaces(self) -> tuple[dict[str, NodeInterfaces], list[str]]:
        """Return the offers of each enclave of the machine, and the nodes that belong to none.

        Raises:
            KeyboardInterrupt: Somebody interrupted.
            StateError: The agent of a host is not in the graph.
            WaitTimeoutError: The bootstrap told nothing in time, or a process is not in the graph.
        """
        tasks = self.read(WAIT_S)
        settle(self)
        participants = {
            node_of(end): bytes(end.endpoint_gid)[:_PREFIX] for end in self.get_publishers_info_by_topic("/rosout")
        }
        enclaves = enclaves_of(tasks, participants)
        of_participant = {participants[node]: name for node, name in enclaves.items() if node in participants}
        if missing := sorted(enclaves.keys() - participants.keys()):
            raise WaitTimeoutError(what=f"node {missing[0]} in the ROS graph", seconds=DISCOVERY_AT_MOST_S)
        offers = {name: NodeInterfaces() for name in enclaves.values()}
        strangers = []
        for node in sorted(participants.keys() - {self.get_fully_qualified_name()}):
            name = of_participant.get(participants[node])
            if name is None:
                strangers.append(node)
            else:
                self._add(node, offers[name])
        return offers, strangers

    def _add(self, node: str, offers: NodeInterfaces) -> None:
        space, _, name = node.rpartition("/")
        with suppress(NodeNameNonExistentError):  # it has gone meanwhile
            offers.published |= {topic for topic, _ in self.get_publisher_names_and_types_by_node(name, space or "/")}
            offers.heard |= {topic for topic, _ in self.get_subscriber_names_and_types_by_node(name, space or "/")}
            offers.served |= {each for each, _ in self.get_service_names_and_types_by_node(name, space or "/")}


def enclaves_of(tasks: Sequence[Mapping[str, Any]], nodes: Collection[str]) -> dict[str, str]:
    """Return the enclave of each node of the deployment, of the bootstrap, and of the agents of other hosts.

    Raises:
        StateError: The agent of a host is not in the graph.
    """
    enclaves = {task["node"]: enclave_of(task["host"], task["process"]) for task in tasks}
    hosts = sorted({task["host"] for task in tasks})
    agents = {host: f"/{agent_name(host)}" for host in hosts}
    first, *absent = [host for host in hosts if agents[host] not in nodes] or [""]
    if absent:
        raise StateError(
            f"of the hosts {first}, {', '.join(absent)} one runs the bootstrap; of the others no agent runs"
        )
    for host, agent in agents.items():
        enclaves["/bootstrap" if host == first else agent] = enclave_of(host, BOOTSTRAP if host == first else AGENT)
    return enclaves


def _make(folder: Path, node: GraphNode) -> int:
    offers, strangers = node.interfaces()
    enclaves = {name: permissions_of(own) for name, own in offers.items()}
    enclaves[CLIENT] = client_permissions(offers.values())
    domain = node.context.get_domain_id()
    Keystore(folder, domain).add(enclaves)
    _tell(folder, domain, offers, strangers)
    return DONE


def _tell(folder: Path, domain: int, offers: Mapping[str, NodeInterfaces], strangers: list[str]) -> None:
    for name, own in sorted(offers.items()):
        print(f"{name}: publishes {len(own.published)} topics, serves {len(own.served)} services")
    print(f"{CLIENT}: hears and calls everything, serves nothing")
    if strangers:
        print(f"without an enclave: {', '.join(strangers)}; such nodes run as {CLIENT}")
    print(
        f"{folder} is a keystore for ROS domain {domain}. Keep {folder / 'private'} on one computer; each host "
        "needs public/ and enclaves/ with its own enclaves.\n"
        "Use it where DDS has security: export ROS_SECURITY_ENABLE=true ROS_SECURITY_STRATEGY=Enforce "
        f"ROS_SECURITY_KEYSTORE={folder.resolve()} ROS_SECURITY_ENCLAVE_OVERRIDE={CLIENT}"
    )


def main() -> int:
    """Run the command."""
    parser = NumberParser(
        prog="im security",
        description="Make a keystore of SROS 2 for the running machine: an authority, and for each process an enclave "
        "that publishes and serves what the process does now, and nothing else. Run the commands once before: some "
        "topics come with their first message.",
        epilog="Example: im security make ~/keystore . Exit codes: 0 done, 1 the keystore cannot be written or the "
        "folder is none, 2 bad usage, 3 no machine runs here or its bootstrap does not answer, 130 interrupted.",
    )
    parser.add_argument("verb", choices=["make"], help="make: write the keystore, or write its permissions anew")
    parser.add_argument("keystore", type=Path, help="folder of the keystore; keys that are there stay")
    options = parser.parse_args()
    return talk(GraphNode, partial(_make, options.keystore), "security")


if __name__ == "__main__":
    sys.exit(main())
