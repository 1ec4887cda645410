"""The page in a real browser: over a machine, in several tabs, after a restart, and over a bag.

With ``IM_PICTURES=FOLDER`` the pictures of the documents are written there (docs/images).
"""

import contextlib
import io
import json
import os
import socket
import socketserver
import threading
import urllib.request
from pathlib import Path
from types import SimpleNamespace
from urllib.parse import urlsplit

import pytest
from PIL import Image

from im_core import clock, names
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis.recorded.timeline import recording_of
from im_pnt_analysis.simulation.replay import FiringSequence
from im_pnt_display import DisplayServer
from im_pnt_display.page.messages import drawn_counterexample, firing_content, net_content
from im_pnt_display.page.recorded_cell import RecordedCell
from im_pnt_display.page.recording import RecordedNets
from support.bag_with_cell import write_bag_with_cell
from support.browser import PATIENCE_S, Tab, headless_browser
from support.loop import in_loop
from support.whole_machine import running_machine

# Chromium itself may hang for ever (its graphics process, without a graphics card): then a test has a second browser.
pytestmark = [pytest.mark.timeout(600), pytest.mark.flaky(reruns=1, only_rerun=["from pytest-timeout"])]

BAGS = Path(__file__).parent / "data" / "bags"
FIRED = "[...document.querySelectorAll('#firings b')].map((each) => each.textContent).join(' ')"
ENDED = "document.getElementById('ended').textContent"
NETS = "[...document.querySelectorAll('#nets a')].map((each) => each.textContent)"
STATE = "document.getElementById('line').textContent"
LETTERS = """[...document.querySelectorAll('#scene text')].map((text) => ({ box: text.getBoundingClientRect(),
    size: parseFloat(getComputedStyle(text).fontSize) * text.getScreenCTM().a }))"""
CONTRAST = """(() => {
    const light = (color) => {
        const [r, g, b] = color.match(/[\\d.]+/g).map((part) => part / 255)
            .map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
        return 0.2126 * r + 0.7152 * g + 0.0722 * b + 0.05;
    };
    const paper = light(getComputedStyle(document.body).backgroundColor);
    const letters = [...document.querySelectorAll('#scene text')].map((text) => light(getComputedStyle(text).fill));
    return Math.min(...letters.map((letter) => letter / paper).map((ratio) => Math.max(ratio, 1 / ratio)));
})()"""
"""The least contrast of letters to the ground, as WCAG 2 defines it."""
SEEN = "[...document.images].some((image) => image.naturalWidth === 4)"
NO_WEBGL = """const made = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
    return kind.startsWith("webgl") ? null : made.call(this, kind, ...more);
};"""
PICTURES = os.environ.get("IM_PICTURES")


@pytest.fixture
def browser():
    """A browser of the test's own: one that hangs takes no other test with it."""
    with headless_browser() as started:
        yield started


@pytest.fixture
def tab(browser):
    """``tab(url, size, ...)``: a tab without errors of scripts."""
    tabs = []

    def opened(*arguments, **context):
        tabs.append(Tab(browser, *arguments, **context))
        return tabs[-1]

    yield opened
    for each in tabs:
        each.close()


def lasting_port():
    """A free port that the kernel gives to no client: one that tries to connect would take it while no machine runs."""
    for port in range(20_000, 32_000):
        with contextlib.suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
    raise AssertionError("no port is free")


def address():
    return names.display_file().read_text().strip()


def connected(each):
    each.until("document.getElementById('link').textContent === 'connected'", "the connection")
    each.until("document.querySelectorAll('#nets a').length >= 12", "the nets")
    return each


def start(each, command, **choices):
    """Start a command by the form of the page."""
    each.until(f"[...document.getElementById('command').options].some((one) => one.value === '{command}')", command)
    each.page.select_option("#command", command)
    for name, value in choices.items():
        each.page.select_option(f"#arguments [name={name}]", value)
    each.page.click("#start button")


def wait_for_shades(each):
    """Wait until the cell is drawn: robots have shades, and so the picture has many colours."""
    deadline = clock.monotonic() + PATIENCE_S
    while clock.monotonic() < deadline:
        picture = Image.open(io.BytesIO(each.page.locator("#robot").screenshot())).convert("RGB")
        if (shades := len(picture.getcolors(1 << 20))) > 200:
            break
        each.page.wait_for_timeout(50)
    assert shades > 200, "robots have shades"


def followed(machine, topic):
    return "pnt_display" in [each.node_name for each in machine.node.get_subscriptions_info_by_topic(topic)]


def test_a_machine_is_seen_and_operated_in_each_tab_and_after_a_restart(tab):
    port = lasting_port()
    with running_machine("--control", port=port) as machine:
        url = address()
        only_looks = connected(tab(url.partition("?")[0] + "#cell=0"))
        assert not followed(machine, "/markers"), "nobody looks at the cell"
        operates = connected(tab(url))
        machine.wait_for(lambda: followed(machine, "/markers"), "the cell to be followed")
        start(operates, "look", camera="ceiling_left")
        for each in (only_looks, operates):
            each.until(f"{ENDED}.includes('look done')", "the end of the command")
            each.until(f"{FIRED}.includes('look')", "its firings")
        machine.wait_for(
            lambda: only_looks.page.evaluate(FIRED) == operates.page.evaluate(FIRED), "the same firings in each tab"
        )
        only_looks.until(f"{ENDED} === {json.dumps(operates.page.evaluate(ENDED))}", "the same ends")
        assert not only_looks.page.is_visible("#start")
        operates.until("[...document.images].some((image) => image.naturalWidth === 640)", "the image of the camera")
        operates.until("document.querySelectorAll('.spot:not([hidden])').length > 0", "the spot in it")
        wait_for_shades(operates)

        start(operates, "calibrate_camera", group="left")
        operates.until(f"/running|calibrate_camera/.test({STATE})", "the command in the line")
        operates.until(f"/\\d+ % .*about \\d+ (s|min) left/.test({STATE})", "progress and the time that is left")
        if PICTURES:
            operates.page.screenshot(path=Path(PICTURES) / "page.png")
            large = connected(tab(f"{url}#cell=1", (700, 1100)))
            wait_for_shades(large)
            for _ in range(4):
                large.page.press("#robot", "+")
            large.page.locator("#robot").screenshot(path=Path(PICTURES) / "cell.png")
            large.page.close()
        operates.page.click("#line button:has-text('pause')")
        only_looks.until(f"{STATE}.includes('paused')", "the pause")
        operates.page.click("#line button:has-text('cancel')")
        only_looks.until(f"{ENDED}.includes('calibrate_camera failed')", "the end of what was cancelled")

        operates.page.click("#estop")
        only_looks.until("document.getElementById('stopped').textContent.startsWith('Emergency stop')", "the stop")
        operates.page.click("#reset")
        only_looks.until("document.getElementById('stopped').hidden", "the reset")
        operates.page.click("#show-cell")
        machine.wait_for(lambda: not followed(machine, "/markers"), "the cell to be left alone")
    for each in (only_looks, operates):
        each.until("document.body.classList.contains('lost')", "the end of the machine to be seen")
    with running_machine("--control", port=port):
        for each in (only_looks, operates):
            each.until("!document.body.classList.contains('lost')", "the new machine")
            each.until(f"!{FIRED}.includes('look')", "the firings of the old machine to go")
        operates.until("document.getElementById('answer').textContent.includes('scripts/im view')", "the other token")
        assert not operates.page.is_visible("#start")
        again = connected(tab(address()))
        start(again, "open_gripper", group="left")
        only_looks.until(f"{ENDED}.includes('open_gripper done')", "a command of the new machine")


STEPS = """
net: steps
places: {idle: 1, here: , there: , near: , lost: }
templates:
  round_trip:
    ports: {in: away, out: returned}
    places: {midway: }
    transitions:
      turn: {in: away, out: midway}
      arrive: {in: midway, out: returned}
commands:
  go:
    arguments: {goal: {type: string}, speed: {type: number, default: 1.0, minimum: 0.1, maximum: 2.0}}
transitions:
  go: {in: idle, out: here, symbol: go}
  walk: {in: here, out: there, action: walk, on_failure: lost}
  back: {use: round_trip, in: there, out: near}
  end: {in: near, out: idle, emit: go_done}
  give_up: {in: lost, out: idle, emit: go_failed}
"""
PART = "document.getElementById('part').innerText"


@pytest.fixture
def small(tmp_path, monkeypatch, ros, wait_until):
    """A dispatcher of one net, and a page that may operate it: its address and the node."""
    from rclpy.parameter import Parameter

    from im_pnt_analysis import verify_to_load
    from im_pnt_display.ros.node import DisplayNode
    from im_pnt_node.ros.node import PntNode

    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    (tmp_path / "steps.yaml").write_text(STEPS)
    alone = [Parameter("standalone", value=True)]
    display = DisplayNode(parameter_overrides=[*alone, Parameter("port", value=0), Parameter("control", value=True)])
    functions = {"walk": lambda ctx: ctx.result.update(walked=3)}
    node = PntNode(
        "dispatcher", [tmp_path / "steps.yaml"], functions, verifier=verify_to_load, parameter_overrides=alone
    )
    ros(display, node)
    wait_until(lambda: display.server.state.snapshot()["markings"], "the net")
    in_loop(node, node.offer_commands)
    return display.server.address, node


def test_a_command_waits_before_a_breakpoint_and_shows_its_values(small, tab):
    url, _ = small
    operates, looks = tab(url), tab(url.partition("?")[0])
    for each in (operates, looks):
        each.until("document.querySelector('[aria-label^=\"transition, walk\"]') !== null", "the net")
    operates.page.click("[aria-label^='transition, walk']")
    assert not operates.page.is_visible("#part-go")
    operates.page.click("#part-break")
    for each in (operates, looks):
        each.until("document.querySelectorAll('.node.stops').length === 1", "the breakpoint in each tab")
    operates.until("document.querySelector('#command option[value=go]') !== null", "the command")
    operates.page.fill("#arguments [name=goal]", "the door")
    for wrong in ("fast", "1e400"):
        operates.page.fill("#arguments [name=speed]", wrong)
        operates.page.click("#start button")
        assert operates.page.inner_text("#answer") == f"go: {wrong} is no number"
    operates.page.fill("#arguments [name=speed]", "7")
    operates.page.click("#start button")
    operates.until("document.getElementById('answer').classList.contains('bad')", "the refusal")
    operates.page.fill("#arguments [name=speed]", "1.5")
    assert operates.page.inner_text("#answer") == "", "what was refused has been changed"
    operates.page.click("#start button")
    for each in (operates, looks):
        each.until("document.querySelectorAll('.node.stops.waits').length === 1", "the token before the transition")
    looks.page.focus("[aria-label^='place, here']")
    looks.page.keyboard.press("Enter")
    looks.until(f"{PART}.includes('go, command 1') && {PART}.includes('the door')", "the values of the token")
    assert not looks.page.is_visible("#part-break")
    looks.page.keyboard.press("Escape")
    assert not looks.page.is_visible("#part")
    operates.page.click("[aria-label^='transition, back']")
    operates.page.click("#part-inside button:has-text('back.arrive')")
    operates.page.click("#part-break")
    for each in (operates, looks):
        each.until("document.querySelectorAll('.node.stops').length === 2", "the breakpoint at the box of the subnet")
    operates.page.click("[aria-label^='transition, walk']")
    operates.page.click("#part-go")
    looks.until("document.querySelectorAll('.node.stops.waits').length === 1", "the token before a transition inside")
    assert operates.page.locator("#tokens > g").count() == 1, "it is shown at the box"
    operates.page.click("[aria-label^='transition, back']")
    operates.page.click("#part-inside button:has-text('back.arrive')")
    operates.page.click("#part-go")
    late = tab(url.partition("?")[0])
    for each in (operates, looks, late):
        each.until(f"{ENDED}.includes('1 go done') && {ENDED}.includes('walked: 3')", "the end of the command")
    operates.until(f"{PART}.includes('t = ')", "the firings of the transition")
    operates.page.click("#part-break")
    operates.page.click("[aria-label^='transition, walk']")
    operates.until("document.getElementById('part-break').textContent.startsWith('clear')", "the other breakpoint")
    operates.page.click("#part-break")
    looks.until("document.querySelectorAll('.node.stops').length === 0", "the end of the breakpoint")


LONG = """
net: long
places: {idle: 1, p0: , asked: }
commands: {go_far: {}}
templates: {step: {parameters: [i], places: {p$(i+1): }, transitions: {step$(i): {in: p$(i), out: p$(i+1)}}}}
use: [{template: step, for: {i: 0..79}}]
transitions:
  begin: {symbol: go_far, in: idle, out: p0}
  ask: {in: p80, out: asked, request: slow.wait, on_failure: asked}
  end: {in: asked, out: idle, emit: go_far_done}
"""
SLOW = """
net: slow
services: {wait: {entry: wanted, done: waited, failed: missed, acts_on: []}}
places: {wanted: , waited: , missed: }
transitions:
  hold: {in: wanted, out: waited, await: {name: /gate, type: std_msgs/msg/Empty}, on_failure: missed}
"""


def test_the_view_follows_the_token_while_an_asked_net_that_is_not_shown_fires(small, tab, wait_until):
    url, node = small
    loaded = []

    async def load_both():
        loaded.extend([await node.loader.load(parse_net(text), 0.0) for text in (SLOW, LONG)])

    node.spawn(load_both())
    wait_until(lambda: len(loaded) == 2, "the nets")
    each = tab(url)
    each.until("document.querySelector('[aria-label^=\"transition, ask\"]') !== null", "the largest net")
    asking = """(() => {
        const ask = document.querySelector('[aria-label^="transition, ask"]').getBoundingClientRect();
        const canvas = document.getElementById('canvas').getBoundingClientRect();
        return ask.left > canvas.left && ask.right < canvas.right && ask.top > canvas.top && ask.bottom < canvas.bottom;
    })()"""
    assert not each.page.evaluate(asking), "the net is larger than the window"
    start(each, "go_far")
    each.until("document.querySelector('[aria-label^=\"transition, ask\"].active') !== null", "the request")
    each.until(asking, "the view at the transition that waits")


def test_a_former_version_is_beside_the_new_one_until_its_commands_have_ended(small, tab, wait_until):
    url, node = small
    looks, operates = tab(url.partition("?")[0]), tab(url)
    operates.until("document.querySelector('[aria-label^=\"transition, walk\"]') !== null", "the net")
    operates.page.click("[aria-label^='transition, walk']")
    operates.page.click("#part-break")
    operates.until("document.querySelector('#command option[value=go]') !== null", "the command")
    operates.page.fill("#arguments [name=goal]", "the door")
    operates.page.click("#start button")
    operates.until("document.querySelectorAll('.node.stops.waits').length === 1", "the token before the transition")
    changed = parse_net(STEPS.replace("  end: {in: near", "  close: {in: near"))
    loaded = []

    async def load():
        loaded.append(await node.loader.load(changed, 0.0))

    node.spawn(load())
    wait_until(lambda: loaded, "the new version")
    (former,) = (name for name, each in node.exchange.nets.items() if each.written.former)
    for each in (looks, operates):
        each.until(f"{NETS}.join() === 'steps,{former}'", "both versions")
    for name, own, others in ((former, "end", "close"), ("steps", "close", "end")):
        looks.page.click(f"#nets a:text-is('{name}')")
        looks.until(f"document.querySelector('[aria-label^=\"transition, {own}\"]') !== null", "its net")
        assert looks.page.query_selector(f"[aria-label^='transition, {others}']") is None
    operates.page.click(f"#nets a:text-is('{former}')")
    operates.until("document.querySelectorAll('.node.stops.waits').length === 1", "the token in the former version")
    operates.page.click("[aria-label^='transition, walk']")
    operates.page.click("#part-go")
    for each in (looks, operates):
        each.until(f"{NETS}.join() === 'steps'", "the former version to go")
        each.until(f"{ENDED}.includes('1 go done')", "the end of the command")


def test_what_ended_before_the_page_was_opened_and_the_log_are_shown(small, tab, wait_until):
    url, node = small
    ended = []

    async def command():
        ended.append(await node.commands.run("go", {"goal": "x"}))

    node.spawn(command())
    wait_until(lambda: ended, "the end of the command")
    each = tab(url)
    each.until(f"{ENDED}.includes('1 go done')", "what has ended")
    wait_until(lambda: node.count_subscribers("/rosout"), "the page to listen")
    each.page.click("#logged")
    wait_until(lambda: (node.get_logger().warning("the door is shut"), each.page.wait_for_timeout(200))
               and "the door is shut" in each.page.inner_text("#log-lines"), "the line")  # fmt: skip
    node.get_logger().info("a door opens")
    each.until("document.getElementById('log-lines').textContent.includes('a door opens')", "the other line")
    each.page.select_option("#log-level", "warning")
    each.until("!document.getElementById('log-lines').textContent.includes('a door opens')", "the level")
    assert "the door is shut" in each.page.inner_text("#log-lines")
    each.page.select_option("#log-node", "dispatcher")
    assert "the door is shut" in each.page.inner_text("#log-lines")
    assert "warning" in each.page.inner_text("#logged")


def test_the_pictures_that_a_command_left_are_shown_and_open_whole(tab, tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    (tmp_path / "7").mkdir()
    Image.new("RGB", (640, 480)).save(tmp_path / "7" / "residuals.png")
    server = DisplayServer(port=0)
    server.start()
    ended = {
        "number": 7,
        "symbol": "go",
        "message": "",
        "success": True,
        "results": {},
        "pictures": ["7/residuals.png"],
    }
    server.state.enter({"kind": "commands", "part": "ended", "content": [ended]})
    each = tab(server.url)
    each.until("document.querySelector('#ended img')?.naturalWidth === 640", "the picture")
    with each.page.expect_popup() as opened:
        each.page.click("#ended img")
    assert opened.value.url == f"{server.url}results/7/residuals.png"
    server.stop()


LINE = """
net: line
places: {free: 1, given: }
transitions:
  begin: {in: free, out: given, symbol: go}
  end: {in: given, out: free, emit: go_done}
"""


def test_a_new_tab_shows_the_net_of_the_newest_command_and_not_the_one_that_gave_it_on(tab):
    """Of either it knows the last firings: of the net at work those in the middle, of the other one the end alone."""
    server = DisplayServer(port=0)
    server.start()
    for text, node in ((LINE, "/dispatcher"), (STEPS, "/dispatcher")):
        net = parse_net(text)
        server.state.enter({"kind": "net", "net": net.name, "node": node, **net_content(net)})
    for net, transition, symbol in (("steps", "walk", ""), ("steps", "end", "go_done"), ("line", "end", "go_done")):
        firing = SimpleNamespace(
            net=net,
            transition=transition,
            symbol=symbol,
            phase=2,
            sequence=1,
            command_id=1,
            duration=0.0,
            progress=0.5,
            message="",
        )
        server.state.enter({"kind": "firing", **firing_content(1.0, firing)})
    each = tab(server.url)
    each.until("document.querySelector('[aria-label^=\"transition, walk\"]') !== null", "the net at work")
    assert each.page.query_selector("[aria-label^='transition, begin']") is None
    server.stop()


@pytest.fixture(scope="module")
def recorded():
    recording = recording_of(BAGS / "faults")
    server = DisplayServer(port=0, recording=RecordedNets("faults", recording))
    server.start()
    yield recording, server.url
    server.stop()


def test_over_a_bag_the_time_line_leads_to_each_moment(recorded, tab):
    recording, url = recorded
    each = tab(url)
    each.until("document.getElementById('count').textContent.startsWith('firing ')", "the beginning")
    each.page.focus("#seek")
    each.page.keyboard.press("End")
    each.until(f"document.getElementById('count').textContent.startsWith('firing {recording.firings} ')", "the end")
    each.page.keyboard.press("Home")
    each.until("document.querySelectorAll('#firings li').length === 0", "the beginning")
    each.page.keyboard.press("ArrowRight")
    each.until("document.querySelectorAll('#firings li').length === 1", "the first firing")


def test_keys_that_are_pressed_before_the_server_answers_count_one_after_the_other(recorded, tab):
    recording, url = recorded
    each = tab(url)
    counted = "document.getElementById('count').textContent.startsWith('firing {} ')"
    each.until(counted.format(recording.firings_until(recording.position_at(0.0))), "the first moment")
    held = []
    each.page.route("**/recording.json*", lambda route: held.append(route) if holding else route.continue_())
    for keys, firing in (
        (("End", "Home", "ArrowRight", "ArrowRight", "ArrowRight", "ArrowLeft"), 2),
        (("ArrowRight", "ArrowLeft", "End", "ArrowLeft", "ArrowLeft"), recording.firings - 2),
    ):
        holding = True
        for key in keys:
            each.page.keyboard.press(key)
        holding = False
        while held:
            held.pop().continue_()
        each.until(counted.format(firing), f"firing {firing}")


@contextlib.contextmanager
def silent_once(url):
    """An address that leads to the page, whose first socket is taken and never answered; and those sockets."""
    silent = []

    def pass_on(source, sink):
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                sink.sendall(data)
            sink.shutdown(socket.SHUT_WR)

    class Door(socketserver.BaseRequestHandler):
        def handle(self):
            asked = self.request.recv(65536)
            if asked.startswith(b"GET /ws") and not silent:
                silent.append(self.client_address)
                self.request.recv(1)
                return
            with socket.create_connection(("127.0.0.1", urlsplit(url).port)) as server:
                server.sendall(asked)
                threading.Thread(target=pass_on, args=(server, self.request), daemon=True).start()
                pass_on(self.request, server)

    with socketserver.ThreadingTCPServer(("127.0.0.1", 0), Door) as proxy:
        proxy.daemon_threads = True
        threading.Thread(target=proxy.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{proxy.server_address[1]}/", silent
        proxy.shutdown()


def test_a_connection_that_is_never_answered_is_given_up_and_tried_again(recorded, tab):
    """As one to a server that stood still when it came."""
    with silent_once(recorded[1]) as (url, silent):
        each = tab(url)
        each.until("document.getElementById('link').textContent === 'connected'", "the second connection")
        assert len(silent) == 1
        each.page.close()


@pytest.fixture(scope="module")
def with_cell(tmp_path_factory):
    """The address of the page over a bag with a cell."""
    bag = tmp_path_factory.mktemp("bags") / "cell"
    write_bag_with_cell(BAGS / "undisturbed", bag)
    server = DisplayServer(port=0, recording=RecordedNets("cell", recording_of(bag), RecordedCell(bag)))
    server.start()
    yield server.url
    server.stop()


def test_over_a_bag_the_cell_is_drawn_as_it_was(with_cell, tab):
    each = tab(with_cell)
    each.until("document.querySelectorAll('#cameras figure').length === 1", "the camera")
    wait_for_shades(each)
    assert not each.page.evaluate(SEEN)
    each.page.keyboard.press("End")
    each.until(SEEN, "the image")


def test_a_command_that_is_being_cancelled_is_abandoned_after_a_confirmation(recorded, tab):
    viewer = tab(recorded[1])
    viewer.until("document.body.classList.contains('recorded')", "the recording, which empties the line")
    viewer.page.evaluate("""async () => {
        const { Commands } = await import("/static/commands.js");
        window.asked = [];
        const commands = new Commands((...request) => window.asked.push(request), () => {});
        const one = { symbol: "go", arguments: "{}", progress: -1, message: "" };
        commands.allow(true);
        commands.take({ part: "listed", content: [
            { ...one, number: 6, state: "running" }, { ...one, number: 7, state: "cancelling" }] });
    }""")
    for answer, asked in (("dismiss", []), ("accept", [["abandon", "7"]])):
        viewer.page.once("dialog", lambda dialog, answer=answer: getattr(dialog, answer)())
        viewer.page.evaluate("document.querySelector(\"#line [data-number='7'] button\").click()")
        assert viewer.page.evaluate("window.asked") == asked
    assert "abandon" not in viewer.page.evaluate("document.querySelector(\"#line [data-number='6']\").textContent")


def test_a_browser_that_cannot_draw_the_cell_says_so_and_shows_the_images(with_cell, tab):
    each = tab(f"{with_cell}#t=1000", script=NO_WEBGL)
    each.until("!document.getElementById('flat').hidden", "the sentence")
    assert "cannot be drawn in three dimensions here" in each.page.inner_text("#flat")
    each.until(SEEN, "the image")


@pytest.mark.parametrize(("size", "scheme"), [((1400, 900), "light"), ((390, 844), "dark")])
def test_letters_can_be_read_at_first_sight(recorded, tab, size, scheme):
    _, url = recorded
    width, _ = size
    each = tab(f"{url}#nets=calibrate_camera&t=60", size, color_scheme=scheme, reduced_motion="reduce")
    each.until("document.querySelectorAll('#firings li').length > 10", "the moment")
    letters = each.page.evaluate(LETTERS)
    assert letters
    assert min(letter["size"] for letter in letters) >= 9.0
    assert each.page.evaluate(CONTRAST) >= 4.5
    area = each.page.locator("#canvas").bounding_box()
    seen = [
        letter
        for letter in letters
        if area["x"] <= letter["box"]["x"] and letter["box"]["right"] <= area["x"] + area["width"]
        and area["y"] <= letter["box"]["y"] and letter["box"]["bottom"] <= area["y"] + area["height"]
    ]  # fmt: skip
    assert len(seen) >= 5, "the surroundings of the token"
    assert each.page.evaluate("document.documentElement.scrollWidth") <= width
    if width < 700:
        assert area["y"] < 20, "the drawing comes first"


def test_rare_parts_are_folded_until_they_are_wanted_and_the_search_finds_them(recorded, tab):
    _, url = recorded
    each = tab(f"{url}#nets=calibrate_camera")
    each.until("document.querySelectorAll('.node').length > 20", "the net")
    usual = each.page.locator(".node").count()
    each.page.click("#rare")
    each.until(f"document.querySelectorAll('.node').length > {usual}", "the rare parts")
    each.page.click("#rare")
    each.until(f"document.querySelectorAll('.node').length === {usual}", "the usual parts")
    each.page.fill("#filter", "unseen.end")
    each.page.press("#filter", "Enter")
    each.until("document.querySelector('[aria-label^=\"transition, unseen.end\"]') !== null", "what was folded")
    box = each.page.locator('[aria-label^="transition, unseen.end"]').bounding_box()
    area = each.page.locator("#canvas").bounding_box()
    assert area["x"] < box["x"] < area["x"] + area["width"]
    assert area["y"] < box["y"] < area["y"] + area["height"]


def test_keys_reach_the_player_of_a_counterexample_from_wherever_the_focus_is(recorded, tab, tmp_path):
    net = load_net(Path(__file__).parent.parent / "docs" / "nets" / "pick_and_place.yaml")
    first = next(name for name, one in net.transitions.items() if all(net.places[place].tokens for place in one.inputs))
    content = drawn_counterexample([net], FiringSequence((f"{first}.start",), (), "it can stand still"))
    (tmp_path / "counterexample.json").write_text(json.dumps(content))
    each = tab(recorded[1])
    each.until("document.body.classList.contains('recorded')", "the recording")
    each.page.set_input_files("#file", tmp_path / "counterexample.json")
    each.until("document.body.classList.contains('playing')", "the player")
    each.page.focus("#file")
    each.page.keyboard.press("End")
    each.until("document.getElementById('step').textContent === '1 of 1'", "the last step")
    each.page.focus("#filter")
    each.page.keyboard.press("Escape")
    each.until("!document.body.classList.contains('playing')", "the end of the player")


def test_a_page_needs_nothing_from_elsewhere(recorded):
    """It works without a network: every script is the server's own."""
    with urllib.request.urlopen(f"{recorded[1]}static/three.module.min.js", timeout=60.0) as script:
        text = script.read().decode()
    assert "three.js" in text.lower()
    assert script.headers["Content-Type"].endswith("/javascript")


def test_without_a_browser_the_tests_are_skipped_and_say_how_to_get_one(monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(pytest.skip.Exception, match="apt-get install chromium"), headless_browser():
        pass
