"""Which network interfaces DDS listens on follows from the deployment (test/test_hosts.py: that it really does)."""

import re
from pathlib import Path

import pytest

from im_bringup.tasks import deployment as deployments
from im_bringup.tasks.deployment import Deployment
from im_bringup.tasks.middleware import (
    PROFILE,
    QOS_FROM_PROFILE,
    loopback_profile,
    middleware,
    open_profile,
    reach,
    require_addresses,
)
from im_core.errors import ConfigError

ONE = deployments.load(deployments.default_path())
TASK = {"package": "a", "executable": "b"}
TWO = Deployment.model_validate(
    {"hosts": {host: {name: {name: {**TASK, "node": f"/{name}"}}} for host, name in (("here", "dom"), ("far", "eye"))}}
)


def test_one_host_listens_on_the_loopback_alone():
    assert middleware({}, ONE)[PROFILE] == str(loopback_profile())
    assert middleware({PROFILE: str(open_profile())}, ONE)[PROFILE] == str(loopback_profile())
    assert reach({}, ONE) == ""


def test_tasks_on_several_hosts_open_it_and_it_is_said():
    assert middleware({PROFILE: "/elsewhere/fastdds.xml"}, TWO)[PROFILE] == str(open_profile())
    assert reach({}, TWO) == "DDS listens on all interfaces, for hosts here, far (docs/security.md)"


def test_addresses_of_the_file_are_the_peers_unless_the_user_has_named_some():
    addresses = {"here": "10.0.0.1", "far": "lab-2.local"}
    both = TWO.model_copy(update={"addresses": addresses})
    assert middleware({}, both)["ROS_STATIC_PEERS"] == "10.0.0.1;lab-2.local;127.0.0.1"
    assert middleware({"ROS_STATIC_PEERS": "10.9.9.9"}, both)["ROS_STATIC_PEERS"] == "10.9.9.9;127.0.0.1"
    assert middleware(middleware({}, both), both) == middleware({}, both)
    assert "ROS_STATIC_PEERS" not in middleware({}, TWO)


@pytest.mark.parametrize(
    ("addresses", "sentence"),
    [
        ({"here": "10.0.0.1", "fra": "10.0.0.2"}, "there is no host 'fra' .did you mean 'far'"),
        ({"here": "10.0.0.1"}, "host 'far' has no address; give one to every host, or to none"),
        ({"here": "10.0.0.1", "far": "10.0.0.1"}, "10.0.0.1 is the address of host 'here'"),
        ({"here": "127.0.0.1", "far": "10.0.0.2"}, "127.0.0.1 means each host itself"),
        ({"here": "10.0.0.1;10.0.0.3", "far": "10.0.0.2"}, "addresses.here"),
    ],
)
def test_wrong_addresses_are_refused(addresses, sentence):
    with pytest.raises(ValueError, match=sentence):
        Deployment.model_validate({**TWO.model_dump(), "addresses": addresses})


def test_an_address_that_nobody_can_look_at_is_told_with_its_line(tmp_path):
    path = tmp_path / "d.yaml"
    path.write_text("addresses:\n  here: 10.0.0.1\n  far: 10.0.0.256\n")
    both = TWO.model_copy(update={"addresses": {"here": "10.0.0.1", "far": "10.0.0.256"}})
    with pytest.raises(
        ConfigError, match=r"d\.yaml:3: addresses\.far: 10\.0\.0\.256: neither an IPv4 address nor a name"
    ):
        require_addresses(both, path)


@pytest.mark.parametrize("deployment", [ONE, TWO])
def test_a_profile_of_the_users_own_is_theirs_and_it_is_said(deployment):
    own = {PROFILE: "/home/me/dds.xml"}
    assert middleware(own, deployment)[PROFILE] == "/home/me/dds.xml"
    assert reach(own, deployment) == f"DDS listens as /home/me/dds.xml says ({PROFILE})"


def test_the_memory_that_dds_keeps_is_as_our_profiles_say_and_theirs_as_they_say():
    assert middleware({}, ONE)[QOS_FROM_PROFILE] == middleware({}, TWO)[QOS_FROM_PROFILE] == "1"
    assert QOS_FROM_PROFILE not in middleware({PROFILE: "/home/me/dds.xml"}, ONE)
    assert loopback_profile().read_text().count("<historyMemoryPolicy>DYNAMIC<") == 3  # of writers, answers, readers


def test_a_profile_in_the_working_directory_opens_nothing():
    assert middleware({}, ONE)["SKIP_DEFAULT_XML_FILE"] == "1"


def test_the_two_profiles_differ_in_nothing_else():
    def content(path, *removed):
        text = re.sub(r"<!--.*?-->|\s+", "", path.read_text(), flags=re.DOTALL)
        for part in removed:
            assert part in text
            text = text.replace(part, "")
        return text

    white_list = "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"
    here = "<locator><udpv4><address>127.0.0.1</address></udpv4></locator>"
    lists = ("metatrafficUnicastLocatorList", "initialPeersList")
    alone = [white_list, *(f"<{name}>{here}</{name}>" for name in lists)]
    assert content(loopback_profile(), *alone) == content(open_profile())


def test_the_scripts_use_the_profile_of_one_host():
    script = Path(__file__).resolve().parents[4] / "scripts" / "lib.sh"
    (named,) = re.findall(rf"{PROFILE}:-\$IM_WS/src/(\S+)\}}", script.read_text())
    assert loopback_profile().as_posix().endswith(named)
