"""Permissions of the enclaves of a machine, and governance of its domain, as DDS Security writes them.

Names are those of ROS 2 on DDS: ``rt/`` topics, ``rq/...Request`` and ``rr/...Reply`` of services. An action is three
services and two topics. The documents follow ``omg_shared_ca_permissions.xsd`` and ``omg_shared_ca_governance.xsd``
(OMG DDS Security 1.1), and what ``sros2`` generates.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.etree import ElementTree as ET

#: Environment variable with the enclave of a process, whatever its arguments say; clients of the machine have it.
ENCLAVE_OVERRIDE = "ROS_SECURITY_ENCLAVE_OVERRIDE"
#: Enclave of everything that is no process of the machine.
CLIENT = "/im/client"
#: Processes that no deployment names: the one on the first host, and those on the others.
BOOTSTRAP, AGENT = "bootstrap", "agent"
#: Topic on which participants tell each other their nodes; no topic of ROS.
_GRAPH = "ros_discovery_info"
#: Services that every node of rclpy has, also that of a client; without them it would not come to be.
_OF_EACH_NODE = (
    "describe_parameters",
    "get_parameter_types",
    "get_parameters",
    "get_type_description",
    "list_parameters",
    "set_parameters",
    "set_parameters_atomically",
)
_GOVERNANCE = {
    "allow_unauthenticated_participants": "false",
    "enable_join_access_control": "true",
    "discovery_protection_kind": "ENCRYPT",
    "liveliness_protection_kind": "ENCRYPT",
    "rtps_protection_kind": "ENCRYPT",
}
_GOVERNED_TOPIC = {
    "topic_expression": "*",
    "enable_discovery_protection": "true",
    "enable_liveliness_protection": "true",
    "enable_read_access_control": "true",
    "enable_write_access_control": "true",
    "metadata_protection_kind": "ENCRYPT",
    "data_protection_kind": "ENCRYPT",
}


def enclave_of(host: str, process: str) -> str:
    """Return the name of the enclave of a process."""
    return f"/im/{host}/{process}"


def enclave_arguments(host: str, process: str) -> list[str]:
    """Return the ROS arguments that put a process into its enclave; without DDS security they change nothing."""
    return ["--ros-args", "--enclave", enclave_of(host, process)]


@dataclass
class NodeInterfaces:
    """Topics and services of nodes, with names of ROS.

    Attributes:
        published: Topics with a publisher.
        heard: Topics with a subscription.
        served: Services, those of actions included.
    """

    published: set[str] = field(default_factory=set)
    heard: set[str] = field(default_factory=set)
    served: set[str] = field(default_factory=set)


@dataclass(frozen=True)
class Permissions:
    """DDS topics that an enclave may write and read; ``*`` stands for any characters.

    Attributes:
        publish: What it may write.
        subscribe: What it may read.
        others_serve: Services in whose place it may not answer, whatever the other two say.
    """

    publish: Sequence[str]
    subscribe: Sequence[str]
    others_serve: Sequence[str] = ()


def permissions_of(own: NodeInterfaces) -> Permissions:
    """Return the permissions of a process: publish and serve its own, hear and call everything.

    Tokens cross between nets on ``/<node>/tokens``: whoever sends the first one begins to publish there.
    """
    publish = [_GRAPH, "rq/*Request", "rt/*/tokens", *(f"rt{topic}" for topic in own.published)]
    replies, requests = _ends(own.served)
    return Permissions(sorted({*publish, *replies}), sorted({_GRAPH, "rt/*", "rr/*Reply", *requests}))


def client_permissions(machine: Iterable[NodeInterfaces]) -> Permissions:
    """Return the permissions of clients: hear and call everything, publish where a process only listens.

    A client publishes no topic of a process, neither heartbeats nor tokens, and offers no service but those that each
    node has, under names that no process of the machine serves.
    """
    offers = list(machine)
    published = {topic for own in offers for topic in own.published}
    waiting = {topic for own in offers for topic in own.heard} - published
    commands = {f"rt{topic}" for topic in waiting if not topic.endswith("/tokens")}
    common = {_GRAPH, "rq/*Request", "rt/rosout", "rt/parameter_events"}
    replies, requests = _ends(f"/*/{name}" for name in _OF_EACH_NODE)
    served = {service for own in offers for service in own.served if service.endswith(_OF_EACH_NODE)}
    return Permissions(
        sorted({*common, *commands, *replies}), sorted({_GRAPH, "rt/*", "rr/*Reply", *requests}), sorted(served)
    )


def _ends(services: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the topics written by a server of services, and the topics read."""
    named = list(services)
    return [f"rr{name}Reply" for name in named], [f"rq{name}Request" for name in named]


def permissions_document(enclave: str, allowed: Permissions, domain: int, valid: Sequence[str]) -> bytes:
    """Return ``permissions.xml`` of an enclave.

    Args:
        enclave: Its name, the common name of its certificate.
        allowed: What it may do; everything else is denied.
        domain: ROS domain.
        valid: From and to, in UTC, as ``2026-01-31T14:25:01``.
    """
    root = _document("permissions")
    grant = ET.SubElement(ET.SubElement(root, "permissions"), "grant", name=enclave)
    _text(grant, "subject_name", f"CN={enclave}")
    _texts(ET.SubElement(grant, "validity"), dict(zip(("not_before", "not_after"), valid, strict=True)))
    rules = {"allow_rule": (allowed.publish, allowed.subscribe)}
    if allowed.others_serve:
        rules = {"deny_rule": _ends(allowed.others_serve), **rules}  # the first that fits counts
    for kind, topics in rules.items():
        rule = ET.SubElement(grant, kind)
        _text(ET.SubElement(rule, "domains"), "id", str(domain))
        for way, names in zip(("publish", "subscribe"), topics, strict=True):
            listed = ET.SubElement(ET.SubElement(rule, way), "topics")
            for topic in names:
                _text(listed, "topic", topic)
    _text(grant, "default", "DENY")
    return _bytes(root)


def governance_document(domain: int) -> bytes:
    """Return ``governance.xml``: all participants authenticated, all topics encrypted and under access control."""
    root = _document("governance")
    rule = ET.SubElement(ET.SubElement(root, "domain_access_rules"), "domain_rule")
    _text(ET.SubElement(rule, "domains"), "id", str(domain))
    _texts(rule, _GOVERNANCE)
    _texts(ET.SubElement(ET.SubElement(rule, "topic_access_rules"), "topic_rule"), _GOVERNED_TOPIC)
    return _bytes(root)


def _document(schema: str) -> ET.Element:
    space = "http://www.w3.org/2001/XMLSchema-instance"
    ET.register_namespace("xsi", space)
    where = f"http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_{schema}.xsd"
    return ET.Element("dds", {f"{{{space}}}noNamespaceSchemaLocation": where})


def _text(parent: ET.Element, tag: str, text: str) -> None:
    ET.SubElement(parent, tag).text = text


def _texts(parent: ET.Element, texts: Mapping[str, str]) -> None:
    for tag, text in texts.items():
        _text(parent, tag, text)


def _bytes(root: ET.Element) -> bytes:
    ET.indent(root)
    text: bytes = ET.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text
