"""Keystores of SROS 2: the layout that rcl reads, documents of DDS Security, signatures that OpenSSL accepts."""

import os
import shutil
import stat
import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest

from im_bringup.security.keystore import Keystore
from im_bringup.security.permissions import CLIENT, NodeInterfaces, client_permissions, enclave_of, permissions_of
from im_core.errors import DataError
from support.permissions import allowed

SERVO = enclave_of("localhost", "servo")
BRAIN = enclave_of("localhost", "brain")
MACHINE = {
    SERVO: NodeInterfaces(
        published={"/joint_states", "/servo/move/_action/feedback"},
        heard={"/servo/joint_trajectory", "/servo/tokens"},
        served={"/servo/estop", "/servo/move/_action/send_goal", "/servo/get_parameters"},
    ),
    BRAIN: NodeInterfaces(published={"/im/task_status"}, heard={"/joint_states"}, served={"/brain/ask"}),
}
# orders of elements, from the schemas of DDS Security 1.1
PERMISSIONS = {
    "dds": ["permissions"],
    "permissions": ["grant"],
    "grant": ["subject_name", "validity", "allow_rule", "default"],
    "validity": ["not_before", "not_after"],
    "deny_rule": ["domains", "publish", "subscribe"],
    "allow_rule": ["domains", "publish", "subscribe"],
}
GOVERNANCE = {
    "dds": ["domain_access_rules"],
    "domain_access_rules": ["domain_rule"],
    "domain_rule": [
        "domains",
        "allow_unauthenticated_participants",
        "enable_join_access_control",
        "discovery_protection_kind",
        "liveliness_protection_kind",
        "rtps_protection_kind",
        "topic_access_rules",
    ],
    "topic_rule": [
        "topic_expression",
        "enable_discovery_protection",
        "enable_liveliness_protection",
        "enable_read_access_control",
        "enable_write_access_control",
        "metadata_protection_kind",
        "data_protection_kind",
    ],
}


@pytest.fixture
def keystore(tmp_path):
    folder = tmp_path / "keystore"
    enclaves = {name: permissions_of(own) for name, own in MACHINE.items()}
    Keystore(folder, 7).add(enclaves | {CLIENT: client_permissions(MACHINE.values())})
    return folder


def document(keystore, path, orders):
    root = ET.fromstring((keystore / "enclaves" / path).read_bytes())
    for tag, order in orders.items():
        for element in root.iter(tag):
            assert [child.tag for child in element if child.tag != "deny_rule"] == order
    assert {each.text for each in root.iter("id")} == {"7"}
    return root


def may(keystore, enclave, way):
    root = document(keystore, f"{enclave.strip('/')}/permissions.xml", PERMISSIONS)
    assert root.find("permissions/grant/subject_name").text == f"CN={enclave}"
    assert root.find("permissions/grant/default").text == "DENY"
    return {topic.text for topic in root.iterfind(f"permissions/grant/allow_rule/{way}/topics/topic")}


def test_a_process_publishes_and_serves_its_own_and_calls_and_hears_everything(keystore):
    publish, subscribe = may(keystore, SERVO, "publish"), may(keystore, SERVO, "subscribe")
    assert {"rt/joint_states", "rr/servo/estopReply", "rr/servo/move/_action/send_goalReply"} <= publish
    assert {"rq/servo/estopRequest", "rq/servo/move/_action/send_goalRequest"} <= subscribe
    assert {"rq/*Request", "rt/*/tokens", "ros_discovery_info"} <= publish
    assert {"rt/*", "rr/*Reply", "ros_discovery_info"} <= subscribe
    assert "rt/im/task_status" not in publish
    assert "rr/brain/askReply" not in publish


def test_a_client_commands_but_serves_nothing_and_sends_no_heartbeat_and_no_token(keystore):
    permissions = keystore / "enclaves" / CLIENT.strip("/") / "permissions.xml"
    publish = {topic for topic in may(keystore, CLIENT, "publish") if not topic.startswith("rr/*/")}
    common = {"ros_discovery_info", "rq/*Request", "rt/rosout", "rt/parameter_events"}
    assert publish == {*common, "rt/servo/joint_trajectory"}
    for reply in ("rr/servo/estopReply", "rr/servo/get_parametersReply", "rr/me/estopReply"):
        assert not allowed(permissions, "publish", reply)
        assert allowed(permissions, "subscribe", reply)
    for topic in ("rt/im/task_status", "rt/servo/tokens"):
        assert not allowed(permissions, "publish", topic)


def test_a_node_of_a_client_has_the_services_without_which_there_is_no_node(keystore):
    permissions = keystore / "enclaves" / CLIENT.strip("/") / "permissions.xml"
    for name in ("get_type_description", "set_parameters_atomically"):
        assert allowed(permissions, "publish", f"rr/me/{name}Reply")
        assert allowed(permissions, "subscribe", f"rq/me/{name}Request")


def test_the_domain_is_encrypted_and_under_access_control(keystore):
    rule = document(keystore, "governance.xml", GOVERNANCE).find("domain_access_rules/domain_rule")
    assert rule.find("allow_unauthenticated_participants").text == "false"
    assert {each.text for each in rule.iter() if each.tag.endswith("protection_kind")} == {"ENCRYPT"}


def test_the_layout_is_that_of_sros2_and_keys_are_of_the_user_alone(keystore):
    for role in ("identity_ca", "permissions_ca"):
        assert (keystore / "public" / f"{role}.cert.pem").is_file()
        assert (keystore / "private" / f"{role}.key.pem").is_file()
    names = {"cert.pem", "key.pem", "governance.p7s", "permissions.p7s", "permissions.xml"}
    names |= {"identity_ca.cert.pem", "permissions_ca.cert.pem"}
    for enclave in (SERVO, BRAIN, CLIENT):
        folder = keystore / "enclaves" / enclave.strip("/")
        assert {path.name for path in folder.iterdir() if path.is_file()} == names
    keys = [path for path in keystore.rglob("*key.pem") if not path.is_symlink()]
    assert len(keys) == 4
    assert {stat.S_IMODE(path.stat().st_mode) for path in keys} == {0o600}


@pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here")
def test_openssl_accepts_certificates_and_signatures(keystore):
    authority = keystore / "public" / "ca.cert.pem"
    folder = keystore / "enclaves" / SERVO.strip("/")
    subprocess.run(["openssl", "verify", "-CAfile", authority, folder / "cert.pem"], check=True)
    for name in ("governance", "permissions"):
        signed = folder / f"{name}.p7s"
        verify = ["openssl", "smime", "-verify", "-text", "-CAfile", authority, "-in", signed]
        assert subprocess.run(verify, check=True, capture_output=True).stdout.startswith(b"<?xml")
    altered = signed.read_bytes().replace(b"joint_states", b"joint_stated")
    (folder / "altered.p7s").write_bytes(altered)
    verify[-1] = folder / "altered.p7s"
    assert subprocess.run(verify, capture_output=True).returncode != 0


def test_keys_stay_when_permissions_are_written_anew(keystore):
    before = {path: path.read_bytes() for path in keystore.rglob("*.pem")}
    other = enclave_of("other", "late")
    Keystore(keystore, 7).add(
        {SERVO: permissions_of(NodeInterfaces(published={"/new"})), other: permissions_of(NodeInterfaces())}
    )
    assert {path: path.read_bytes() for path in before} == before
    assert "rt/new" in may(keystore, SERVO, "publish")
    assert "rt/joint_states" not in may(keystore, SERVO, "publish")
    assert may(keystore, other, "publish")


def test_a_folder_with_something_else_is_left_alone(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(DataError, match=r"is neither empty nor a keystore: it has no private/ca\.key\.pem"):
        Keystore(tmp_path, 0)
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_an_authority_that_cannot_be_read_is_named(keystore):
    (keystore / "private" / "ca.key.pem").write_text("no key")
    with pytest.raises(DataError, match=f"the authority of keystore {keystore} cannot be read"):
        Keystore(keystore, 7)


def test_rcl_finds_the_enclave_and_hands_it_to_the_middleware(keystore):
    """What rcl refuses ends before the middleware is asked; this Fast DDS says that it was built without security."""
    code = "import rclpy, sys; rclpy.init(args=sys.argv); rclpy.create_node('one')"
    secure = {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce", "ROS_SECURITY_KEYSTORE": str(keystore)}

    def run(enclave):
        argv = [sys.executable, "-c", code, "--ros-args", "--enclave", enclave]
        return subprocess.run(argv, env={**os.environ, **secure}, capture_output=True, text=True, timeout=120).stderr

    assert "enclaves/im/localhost/nobody' does not exist" in run("/im/localhost/nobody")
    told = run(SERVO)
    assert "SECURITY ERROR" not in told
    assert "security" in told.lower()
