"""The display server shows what nets do, to any number of viewers."""

import asyncio
import contextlib
import json
import threading
import urllib.request

import aiohttp
import pytest
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import CompressedImage, JointState
from std_msgs.msg import String

from im_core import clock
from im_core.ros import qos
from im_core.ros.run import spin_in_thread
from im_msgs.msg import Firing, GroupStatus, Marking, McsState, NetDescription, NetRefusal
from im_msgs.srv import ControlNet
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_display import DisplayServer
from im_pnt_display.ros.node import DisplayNode
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop
from support.viewer import next_change

NET = """
net: shown
places: {idle: 1, here: , there: , lost: }
transitions:
  go: {in: idle, out: here, symbol: go}
  walk: {in: here, out: there, action: walk, on_failure: lost}
  back: {in: there, out: idle, emit: go_done}
  give_up: {in: lost, out: idle, emit: go_failed}
"""


@pytest.fixture
def machine(tmp_path, monkeypatch, wait_until):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "shown.yaml").write_text(NET)
    rclpy.init()
    alone = [Parameter("standalone", value=True)]
    display = DisplayNode(parameter_overrides=[*alone, Parameter("port", value=0)])
    walk = {"walk": lambda ctx: None}
    walker = PntNode("walker", [tmp_path / "shown.yaml"], walk, verifier=verify_to_load, parameter_overrides=alone)
    with spin_in_thread(display, walker):
        wait_until(lambda: all(display.server.state.snapshot()[kind] for kind in ("nets", "markings")), "the net")
        yield display, walker
    rclpy.try_shutdown()


def go(walker):
    ended = threading.Event()

    async def work():
        await walker.commands.run("go")
        ended.set()

    walker.executor.create_task(work())
    walker.wake()
    assert ended.wait(60.0)


async def watch(url, started, until):
    changes = []
    async with aiohttp.ClientSession() as session, session.ws_connect(f"{url}ws") as socket:
        started.release()
        while not until(changes):
            changes.append(await next_change(socket))
    return changes


def ended(changes):
    return any(c["kind"] == "firing" and c["transition"] == "back" for c in changes)


def test_two_viewers_see_the_same_firings_and_the_page_is_there(machine):
    display, walker = machine
    started = threading.Semaphore(0)

    async def look():
        viewers = [asyncio.create_task(watch(display.server.url, started, ended)) for _ in range(2)]
        async with aiohttp.ClientSession() as session:
            for path in ("", "static/display.js", "static/display.css"):
                async with session.get(display.server.url + path) as answer:
                    assert answer.status == 200
            async with session.get(display.server.url + "ws", headers={"Origin": "http://elsewhere"}) as answer:
                assert answer.status == 403
        return await asyncio.gather(*viewers)

    def command_when_watched():
        for _ in range(2):
            assert started.acquire(timeout=60.0)
        clock.sleep(0.1)
        go(walker)

    threading.Thread(target=command_when_watched).start()
    first, second = asyncio.run(look())
    for changes in (first, second):
        snapshot = changes[0]
        assert [net["net"] for net in snapshot["nets"]] == ["shown"]
        assert snapshot["markings"][0]["tokens"] == {"idle": 1}
        nodes = {node["name"] for node in snapshot["nets"][0]["drawing"]["nodes"]}
        assert {"idle", "here", "there", "lost", "go", "walk", "back", "give_up"} == nodes
        fired = [(c["transition"], c["phase"]) for c in changes if c["kind"] == "firing"]
        assert fired == [("go", "END"), ("walk", "START"), ("walk", "END"), ("back", "END")]


def test_a_second_display_takes_the_next_port(machine):
    display, _ = machine
    port = int(display.server.url.rsplit(":", 1)[1].strip("/"))
    other = DisplayServer(port=port)
    other.start()
    try:
        assert other.url != display.server.url
    finally:
        other.stop()


def test_a_display_whose_address_cannot_be_written_shows_nets_all_the_same(tmp_path, monkeypatch, ros, wait_until):
    """It shares its process with the dispatcher, which would end with it."""
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "pnt_display.url").mkdir()
    display = DisplayNode(parameter_overrides=[Parameter("standalone", value=True), Parameter("port", value=0)])
    ros(display)

    wait_until(lambda: display.count_subscribers("/pnt/nets"), "the display to follow nets")
    with urllib.request.urlopen(display.server.url, timeout=60.0) as page:
        assert page.status == 200


def test_messages_that_make_no_sense_are_passed_over(machine, wait_until):
    display, walker = machine
    nets = walker.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED_MANY)
    refusals = walker.create_publisher(NetRefusal, "/pnt/refusals", qos.LATCHED_MANY)
    firings = walker.create_publisher(Firing, "/pnt/firings", qos.EVENTS)
    markings = walker.create_publisher(Marking, "/pnt/markings", qos.LATCHED_MANY)
    wait_until(firings.get_subscription_count, "the display to listen to firings")
    for text in ("[]", "{}", "5", "{", "[" * 100_000, json.dumps({"yaml": "# x\n" * 2_500_000})):
        nets.publish(NetDescription(net="bad", node="/nobody", json=text))
        refusals.publish(NetRefusal(net="bad", node="/nobody", json=text))
    firings.publish(Firing(net="bad", transition="t", duration=float("nan")))
    firings.publish(Firing(net="odd", transition="t", phase=77))
    markings.publish(Marking(net="bad", places=["a", "b"], tokens=[1]))
    good = json.dumps({"yaml": NET.replace("net: shown", "net: good")})
    nets.publish(NetDescription(net="good", node="/nobody", json=good))
    state = display.server.state.snapshot
    wait_until(lambda: len(state()["nets"]) >= 2 and state()["firings"], "the good net and the odd firing")
    shown = state()
    assert [net["net"] for net in shown["nets"]] == ["good", "shown"]
    assert [firing["phase"] for firing in shown["firings"]] == ["77"]
    assert [marking["net"] for marking in shown["markings"]] == ["shown"]


def test_a_net_that_was_unloaded_leaves_the_page_until_it_is_loaded_again(machine, wait_until):
    display, walker = machine
    go(walker)
    nets = walker.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED_MANY)
    nets.publish(NetDescription(net="shown", node="/nobody"))  # whose net it is not
    other = json.dumps({"yaml": NET.replace("net: shown", "net: other")})
    nets.publish(NetDescription(net="other", node="/nobody", json=other))

    def names():
        return [net["net"] for net in display.server.state.snapshot()["nets"]]

    wait_until(lambda: names() == ["other", "shown"], "another net on the page")
    started = threading.Semaphore(0)

    def unload():
        assert started.acquire(timeout=60.0)
        walker.spawn(walker.loader.unload("shown"))

    threading.Thread(target=unload).start()
    heard = asyncio.run(watch(display.server.url, started, lambda told: any(c["kind"] == "gone" for c in told)))
    assert heard[-1] == {"kind": "gone", "net": "shown"}
    assert names() == ["other"]
    assert not display.server.state.snapshot()["markings"]
    walker.spawn(walker.load_net(parse_net(NET, "shown.yaml")))
    wait_until(lambda: names() == ["other", "shown"], "the net on the page again")


def test_a_net_that_two_nodes_describe_stays_on_the_page_when_one_of_them_runs_it_no_more(machine, wait_until):
    display, walker = machine
    nets = walker.create_publisher(NetDescription, "/pnt/nets", qos.LATCHED_MANY)

    def shown():
        (net,) = display.server.state.snapshot()["nets"]
        nodes = sorted(node["name"] for node in net["drawing"]["nodes"])
        return net["node"], nodes, in_loop(display, display._asker, "shown", ControlNet, "control_net").srv_name

    own = shown()
    assert own[::2] == ("/walker", "/walker/control_net")
    text = json.dumps({"yaml": "net: shown\nplaces: {a: 1}\ntransitions: {t: {in: a, out: a}}\n"})
    nets.publish(NetDescription(net="shown", node="/nobody", json=text))
    wait_until(lambda: shown() == ("/nobody", ["a", "t"], "/nobody/control_net"), "the newest description")
    nets.publish(NetDescription(net="shown", node="/nobody"))
    wait_until(lambda: shown() == own, "that of the node that runs the net")


def test_what_motion_control_said_last_is_stale_when_it_has_fallen_silent(machine, wait_until):
    display, walker = machine
    shown = display.server.state.snapshot
    assert shown()["mcs"] is None
    walker.create_publisher(McsState, "/mcs/state", qos.LATCHED).publish(
        McsState(state="motion", power=True, groups=[GroupStatus(group="left", state="motion", reserved=True)])
    )
    said = {"kind": "mcs", "state": "motion", "reason": "", "power": True, "brakes": False}
    said |= {"groups": {"left": "motion"}, "protective_stop": "", "stopped": {}}
    wait_until(lambda: shown()["mcs"] == {**said, "stale": False}, "the state of MCS on the page")
    display._mcs.silence_s = 0.0
    wait_until(lambda: shown()["mcs"] == {**said, "stale": True}, "it to be marked as stale")


def test_of_descriptions_that_come_faster_than_they_are_drawn_the_last_of_each_net_is(machine, wait_until, monkeypatch):
    display, _ = machine
    drawn, may_draw, draws = [], threading.Event(), threading.Event()

    def draw(name, text, node):
        draws.set()
        assert may_draw.wait(60.0)
        drawn.append((name, text))
        return {}

    monkeypatch.setattr("im_pnt_display.page.messages.described_net", draw)
    in_loop(display, display._describe, NetDescription(net="large", node="/n", json="1"))
    assert draws.wait(60.0)
    for number in range(20):
        for name in ("large", "small"):
            in_loop(display, display._describe, NetDescription(net=name, node="/n", json=f"{number}"))
    may_draw.set()
    wait_until(lambda: len(drawn) == 3, "the drawings")
    assert drawn == [("large", "1"), ("large", "19"), ("small", "19")]
    in_loop(display, display._describe, NetDescription(net="last", node="/n", json="0"))
    wait_until(lambda: ("last", "0") in drawn, "another drawing")
    assert len(drawn) == 4


def test_the_cell_and_the_commands_are_followed_while_somebody_looks(machine, wait_until):
    display, walker = machine
    robots = walker.create_publisher(String, "/robot_description", qos.LATCHED)
    joints = walker.create_publisher(JointState, "/joint_states", qos.EVENTS)
    images = walker.create_publisher(CompressedImage, "/wall/image_raw/compressed", qos.IMAGES)
    robots.publish(String(data="<robot/>"))
    topics = ("/robot_description", "/joint_states", "/wall/image_raw/compressed", "/markers", "/dispatcher/commands")

    def followed():
        counts = [walker.count_subscribers(topic) for topic in topics]
        return all(counts) if any(counts) else None

    assert followed() is None
    wait_until(lambda: "/wall/image_raw/compressed" in dict(display.get_topic_names_and_types()), "the camera")

    async def look():
        parts = {}
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{display.server.url}ws") as viewer:
            await viewer.send_json({"net": "", "request": "look", "argument": "cell"})
            while parts.keys() < {"robot", "joints", "image/wall"}:
                if followed():
                    joints.publish(JointState(name=["j"], position=[0.5]))
                    images.publish(CompressedImage(format="jpeg", data=b"JPEG"))
                with contextlib.suppress(TimeoutError):
                    change = await next_change(viewer, 0.2)
                    if change["kind"] == "cell":
                        parts[change["part"]] = change["content"]
        return parts

    parts = asyncio.run(asyncio.wait_for(look(), 60.0))
    assert parts == {"robot": "<robot/>", "joints": {"j": 0.5}, "image/wall": "data:image/jpeg;base64,SlBFRw=="}
    wait_until(lambda: followed() is None, "everything to be left alone")


def test_who_operates_starts_and_controls_commands_and_is_told_what_was_refused(tmp_path, monkeypatch, wait_until, ros):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "shown.yaml").write_text(NET)
    alone = [Parameter("standalone", value=True)]
    held = []

    async def walk(ctx):
        held.append(dispatcher.promise())
        await held[-1]

    display = DisplayNode(parameter_overrides=[*alone, Parameter("port", value=0), Parameter("control", value=True)])
    dispatcher = PntNode(
        "dispatcher", [tmp_path / "shown.yaml"], {"walk": walk}, verifier=verify_to_load, parameter_overrides=alone
    )

    async def talk():
        changes = []
        socket = display.server.address.replace("/?", "/ws?")

        async def until(wanted):
            while not any(wanted(change) for change in changes):
                changes.append(await next_change(viewer))
            return next(change for change in changes if wanted(change))

        def answered(words):
            return until(lambda change: change["kind"] == "answer" and words in change["message"])

        def told(part, number):
            return until(
                lambda change: (
                    change["kind"] == "commands"
                    and change["part"] == part
                    and any(each["number"] == number for each in change["content"])
                )
            )

        async def ask(request, argument):
            await viewer.send_json({"net": "", "request": request, "argument": argument})

        async with aiohttp.ClientSession() as session, session.ws_connect(socket) as viewer:
            known = await until(lambda change: change["kind"] == "commands" and change["part"] == "known")
            assert [each["symbol"] for each in known["content"]] == ["go"]
            for request, argument, words in (
                ("start", '{"symbol": "gone"}', "gone"),
                ("start", "5", "a command"),
                ("pause", "x", "'x' is no number of a command"),
                ("pause", "77", "77"),
                ("dance", "", "'dance' is nothing that a machine can do"),
            ):
                await ask(request, argument)
                assert not (await answered(words))["success"]
            await ask("start", '{"symbol": "go"}')
            assert (await answered("go is command 1"))["success"]
            (listed,) = (await told("listed", 1))["content"]
            assert (listed["symbol"], listed["state"]) == ("go", "running")
            held[0].set_result(None)
            (ended,) = (await told("ended", 1))["content"]
            assert (ended["symbol"], ended["success"]) == ("go", True)

    ros(display, dispatcher)
    wait_until(lambda: display.server.state.snapshot()["markings"], "the net")
    in_loop(dispatcher, dispatcher.offer_commands)
    asyncio.run(asyncio.wait_for(talk(), 120.0))


def test_a_display_that_takes_the_place_of_a_killed_one_keeps_its_token(tmp_path, monkeypatch, ros):
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "pnt_display.url").write_text("http://localhost:1/?token=former\n")
    own = [Parameter("standalone", value=True), Parameter("port", value=0), Parameter("control", value=True)]
    display = ros(DisplayNode(parameter_overrides=own))
    assert display.server.address == f"{display.server.url}?token=former"
