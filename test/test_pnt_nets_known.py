"""What a node knows of the nets of others: who runs them, and what they are."""

import json
from pathlib import Path

import pytest
from rclpy.parameter import Parameter

from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_msgs.msg import NetDescription
from im_pnt.errors import NetError
from im_pnt.netfile import parse_net
from im_pnt.verification import accept
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.library import Library
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

ALONE = [Parameter("standalone", value=True)]

ASKER = """
net: asker
places: {idle: 1, fed: , told: , bad: }
transitions:
  ask: {symbol: ask, in: idle, out: fed, request: feeder.feed, on_failure: bad}
  mark: {in: fed, out: told, request: marker.feed, on_failure: bad}
  tell: {in: told, out: idle, emit: ask_done}
  give_up: {in: bad, out: idle, emit: ask_failed}
"""
FEEDER = """
net: feeder
places: {wanted: , given: , none_left: }
services: {feed: {entry: wanted, done: given, failed: none_left}}
transitions: {give: {in: wanted, out: given, action: give, on_failure: none_left}}
"""


IDLE = "{net: NAME, places: {a: 1}, transitions: {t: {in: a, out: a, delay: 9}}}"
MANY = 120  # more than what is latched elsewhere


class Teller(ManagedNode):
    """Tells of nets that it runs, or runs no more."""

    def __init__(self, name: str) -> None:
        super().__init__(name, parameter_overrides=ALONE)
        self.descriptions = self.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED_MANY)

    def tell(self, net: str, text: str) -> None:
        json_text = json.dumps({"yaml": text}) if text else ""
        self.descriptions.publish(NetDescription(net=net, node=f"/{self.task_name}", json=json_text))


def make_asker(folder: Path) -> PntNode:
    (folder / "asker.yaml").write_text(ASKER)
    return PntNode("asker", [folder / "asker.yaml"], verifier=verify_to_load, parameter_overrides=ALONE)


def test_a_net_that_another_node_has_taken_over_stays_known_whatever_the_former_one_says(tmp_path, ros, wait_until):
    node, former, present = ros(make_asker(tmp_path)), Teller("former"), Teller("present")
    ros(former, present)

    def known() -> dict[str, str]:
        nets = in_loop(node, node.net_with_servers, "asker")
        return {net.name: node._transport.node_of(net.name) for net in nets if net.name != "asker"}

    wait_until(lambda: node.ready, "the node")
    former.tell("feeder", FEEDER)
    wait_until(lambda: known() == {"feeder": "former"}, "the net of the former node")
    present.tell("feeder", FEEDER)
    wait_until(lambda: known() == {"feeder": "present"}, "the net of the node that has taken it over")
    former.tell("feeder", "")
    former.tell("marker", FEEDER.replace("feeder", "marker"))
    wait_until(lambda: "marker" in known(), "what the former node says last")
    assert known() == {"feeder": "present", "marker": "former"}
    present.tell("feeder", "")
    wait_until(lambda: known() == {"marker": "former"}, "the net to go")
    assert node._transport.node_of("feeder") == "feeder"


@pytest.mark.parametrize(("node", "text"), [("/no such name", '{"yaml": ""}'), ("/other", "x")])
def test_a_description_that_makes_no_sense_leads_no_request_anywhere(tmp_path, ros, wait_until, node, text):
    asker, teller = ros(make_asker(tmp_path)), ros(Teller("teller"))
    wait_until(lambda: asker.ready, "the node")
    teller.descriptions.publish(NetDescription(net="feeder", node=node, json=text))
    teller.tell("marker", FEEDER.replace("feeder", "marker"))
    wait_until(lambda: in_loop(asker, asker._transport.node_of, "marker") == "teller", "what is told last")
    assert in_loop(asker, asker._transport.node_of, "feeder") == "feeder"


def test_a_net_that_no_own_net_asks_is_read_when_a_net_is_loaded_and_not_before(tmp_path, ros, wait_until):
    asker, teller = ros(make_asker(tmp_path)), ros(Teller("teller"))
    wait_until(lambda: asker.ready, "the node")
    teller.tell("stranger", "no net")
    teller.tell("feeder", FEEDER)
    wait_until(lambda: len(in_loop(asker, asker.net_with_servers, "asker")) == 2, "the net that is asked")
    assert not asker.failures.counts
    loaded = []

    async def load():
        await asker.load_net(parse_net(IDLE.replace("NAME", "idle")))
        loaded.append(True)

    asker.spawn(load())
    wait_until(lambda: loaded, "the net")
    assert "/teller:1:1: 'no net' is not a mapping" in asker.failures.last


def test_so_many_nets_of_others_are_known_and_those_stay(tmp_path, ros, wait_until, monkeypatch):
    monkeypatch.setattr("im_pnt_node.ros.execution.transport.MOST_NETS", 2)
    asker, teller = ros(make_asker(tmp_path)), ros(Teller("teller"))
    wait_until(lambda: asker.ready, "the node")
    for net in ("marker", "feeder"):  # beside the asker itself
        teller.tell(net, FEEDER.replace("feeder", net))
    wait_until(lambda: asker.failures.counts, "the refusal")
    known = [in_loop(asker, asker._transport.node_of, net) for net in ("marker", "feeder")]
    assert known == ["teller", "feeder"]
    assert "who runs net feeder is not learned: it is known of 2 others" in asker.failures.last


def test_who_comes_late_is_told_of_all_nets_and_of_none_that_has_long_gone(tmp_path, ros, wait_until, monkeypatch):
    monkeypatch.setattr("im_pnt_node.ros.reporting.publish.GONE_S", 0.2)
    asker = ros(make_asker(tmp_path))
    wait_until(lambda: asker.ready, "the node")
    loaded = []

    async def load(many):
        for number in many:
            await asker.load_net(parse_net(IDLE.replace("NAME", f"n{number}")))
        for number in list(many)[:2]:
            await asker.loader.unload(f"n{number}")
        loaded.append(True)

    asker.spawn(load(range(MANY)))
    wait_until(lambda: loaded, "the nets", 60.0)
    ends = ("/pnt/nets", "/pnt/markings")
    wait_until(lambda: [asker.count_publishers(topic) for topic in ends] == [MANY - 1] * 2, "publishers to go")
    told, late = set(), ManagedNode("late", parameter_overrides=ALONE)
    late.create_subscription(NetDescription, "/pnt/nets", lambda message: told.add(message.net), qos.LATCHED_NETS)
    ros(late)
    wait_until(lambda: len(told) == MANY - 1, "all nets")
    assert not told & {"n0", "n1"}


def test_two_files_with_a_net_of_one_name_are_refused_and_both_are_named(tmp_path):
    files = [tmp_path / "feeder.yaml", tmp_path / "feeder_backup.yaml"]
    for file in files:
        file.write_text(FEEDER)
    with pytest.raises(NetError, match=f"^there are two nets named feeder: {files[0]} and {files[1]}$"):
        Library(files, accept).nets({}, typed=False)
