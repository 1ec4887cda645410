"""The server of the page: whom it answers, what it tells browsers, and what it takes from viewers."""

import asyncio
import contextlib
import http.client
import json
import re
import shutil
import socket
import subprocess
import threading
from pathlib import Path

import aiohttp
import pytest

from im_core.clock import monotonic
from im_core.errors import LinkError
from im_pnt_display.page import site as module
from im_pnt_display.page.server import WEB_PROCESS, DisplayServer
from im_pnt_display.page.site import (
    LONGEST_REQUEST,
    MOST_CONNECTIONS,
    MOST_VIEWERS,
    PAGE_AT_ONCE,
    PAGE_PER_S,
    READ_ONLY,
    TOO_FAST,
    TOO_MANY,
    Allowance,
)
from im_pnt_display.page.state import MOST_CELL_PARTS, REFUSALS_KEPT, DisplayState
from im_pnt_display.page.viewers import MOST_UNSENT, Viewers
from support.viewer import next_change

ASKED = {"net": "n", "request": "pause", "argument": ""}


@pytest.fixture
def serve():
    servers = []

    def start(**settings):
        server = DisplayServer(port=0, **settings)
        servers.append(server)
        server.start()
        return server

    yield start
    for server in servers:
        server.stop()


def port_of(server):
    return int(server.url.rpartition(":")[2].strip("/"))


def asked(server, path="", **headers):
    async def ask():
        async with aiohttp.ClientSession() as session, session.get(server.url + path, headers=headers) as answer:
            return answer.status, answer.headers, await answer.text()

    return asyncio.run(ask())


def socket_of(server):
    """The address of the socket of who may do whatever the page may."""
    return f"{server.url}ws{server.address.removeprefix(server.url)}"


def told(server, *texts, kinds=("answer",)):
    """What a viewer hears that sends texts, until the last kind that it waits for."""

    async def talk():
        async with aiohttp.ClientSession() as session, session.ws_connect(socket_of(server)) as viewer:
            heard = [await next_change(viewer)]
            for text in texts:
                await viewer.send_str(text)
            while kinds and heard[-1]["kind"] not in kinds:
                heard.append(await next_change(viewer))
            return heard

    return asyncio.run(talk())


@pytest.mark.parametrize("name", ["localhost", "LOCALHOST", "127.0.0.1", "[::1]"])
@pytest.mark.parametrize("path", ["", "state.json", "static/display.js"])
def test_it_answers_to_its_own_names(serve, name, path):
    server = serve()
    host = f"{name}:{port_of(server)}"
    assert asked(server, path, Host=host, Origin=f"http://{host}")[0] == 200


def test_the_configured_name_is_served(serve):
    server = serve(host="127.0.0.2")
    assert asked(server, Host=f"127.0.0.2:{port_of(server)}")[0] == 200
    assert asked(server, Host="127.0.0.3")[0] == 403


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.2", 200),
        ("lab-pc", 200),
        ("LAB-PC.example.org", 200),
        ("localhost", 200),
        ("127.0.0.3", 403),
        ("0.0.0.0", 403),
        ("evil.example", 403),
        ("lab-pc.evil.example", 403),
        ("127.0.0.2.evil.example", 403),
    ],
)
def test_on_all_addresses_it_answers_to_the_names_and_addresses_of_this_computer(serve, monkeypatch, host, status):
    monkeypatch.setattr("socket.gethostname", lambda: "Lab-PC")
    monkeypatch.setattr("socket.getfqdn", lambda: "lab-pc.example.org")
    port = port_of(serve(host="0.0.0.0"))
    there = http.client.HTTPConnection("127.0.0.2", port, timeout=60.0)
    there.request("GET", "/", headers={"Host": f"{host}:{port}", "Origin": f"http://{host}:{port}"})
    assert there.getresponse().status == status
    there.close()


@pytest.mark.parametrize(
    "host",
    ["evil.example", "evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example", "[::2]", "[", "x" * 5000],
)
@pytest.mark.parametrize("path", ["", "state.json", "ws", "static/display.js", "nothing"])
def test_a_name_that_was_made_to_point_here_is_not_served(serve, host, path):
    status, headers, text = asked(serve(), path, Host=host)
    assert status == 403
    assert "is not served here; served are 127.0.0.1, ::1, localhost" in text
    assert headers["X-Frame-Options"] == "DENY"


@pytest.mark.parametrize("origin", ["http://evil.example", "http://localhost:1", "https://127.0.0.1", "null", ""])
@pytest.mark.parametrize("path", ["ws", "state.json"])
def test_pages_of_elsewhere_are_refused(serve, origin, path):
    server = serve()
    assert asked(server, path, Host=f"127.0.0.1:{port_of(server)}", Origin=origin)[0] == 403


@pytest.mark.parametrize("path", ["", "state.json", "static/display.js", "missing"])
def test_browsers_are_told_what_the_page_may_do(serve, path):
    _, headers, _ = asked(serve(), path)
    policy = dict(part.strip().split(" ", 1) for part in headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == policy["frame-ancestors"] == "'none'"
    assert policy["script-src"] == "'self'"
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cache-Control"] == "no-cache"


def test_the_page_needs_nothing_that_the_policy_forbids():
    page = (module.STATIC / "index.html").read_text()
    assert " style=" not in page
    assert not re.search(r"\son[a-z]+=", page)
    assert page.count("<script") == page.count('<script src="/static/') == 1
    scripts = "".join(path.read_text() for path in module.STATIC.glob("*.js"))
    assert not any(word in scripts for word in ("eval(", "innerHTML", "new Function", "cssText", '"style"'))


def test_a_page_only_looks_unless_it_may_operate(serve):
    server = serve()
    snapshot, answer = told(server, json.dumps(ASKED))
    assert snapshot["operable"] is False
    assert answer == {"kind": "answer", "net": "n", "success": False, "message": READ_ONLY}


def test_who_may_operate_is_heard(serve):
    heard = []
    server = serve(operate=lambda wanted: (heard.append(wanted), server.show({"kind": "done"})))
    assert told(server, json.dumps(ASKED), kinds=("done",))[0]["operable"] is True
    assert heard == [ASKED]


@pytest.mark.parametrize("path", ["", "ws"])
@pytest.mark.parametrize("token", ["", "wrong", "\u00e4"])
def test_whoever_has_another_token_is_told_where_the_right_one_is(serve, path, token):
    server = serve(operate=lambda wanted: None, token="right")
    assert asked(server, f"{path}?token={token}")[::2] == (403, module.WRONG_TOKEN)
    assert asked(server)[0] == 200, "who only looks needs none"
    assert server.address == f"{server.url}?token=right"


def test_without_the_token_a_page_only_looks(serve):
    heard = []
    server = serve(operate=heard.append)

    async def talk():
        async with aiohttp.ClientSession() as session, session.ws_connect(f"{server.url}ws") as viewer:
            await next_change(viewer)
            await viewer.send_json(ASKED)
            return await next_change(viewer)

    assert asyncio.run(talk())["message"] == READ_ONLY
    assert heard == []
    other = serve(operate=heard.append)
    assert server.address.partition("?")[2] != other.address.partition("?")[2], "each has a token of its own"


@pytest.mark.parametrize("apart", [False, True])
def test_the_cell_is_for_who_looks_at_it_and_its_viewers_are_counted(serve, wait_until, apart):
    counted = []
    server = serve(audience=lambda *numbers: counted.append(numbers), apart=apart)

    async def talk():
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(socket_of(server)) as other,
            session.ws_connect(socket_of(server)) as viewer,
        ):
            for each in (other, viewer):
                await next_change(each)
            server.show({"kind": "cell", "part": "robot", "content": "<robot/>"})
            server.show({"kind": "cell", "part": "marker/a/1", "content": None})
            server.show({"kind": "done"})
            assert (await next_change(viewer))["kind"] == "done"
            await viewer.send_json({"net": "", "request": "look", "argument": "cell"})
            parts = [await next_change(viewer)]
            server.show({"kind": "cell", "part": "joints", "content": {"j": 1.0}})
            parts.append(await next_change(viewer))
            await viewer.send_json({"net": "", "request": "look", "argument": ""})
            while counted[-1] != (2, 0):
                await asyncio.sleep(0.01)
            server.show({"kind": "cell", "part": "joints", "content": {"j": 2.0}})
            server.show({"kind": "done"})
            assert (await next_change(viewer))["kind"] == "done"
            assert [(await next_change(other))["kind"] for _ in range(2)] == ["done", "done"]
            return parts

    assert [part["content"] for part in asyncio.run(talk())] == ["<robot/>", {"j": 1.0}]
    wait_until(lambda: counted[-1] == (0, 0), "the leaving of all")
    assert (2, 1) in counted


def test_changes_wake_the_server_once_for_all_until_it_looks(serve, wait_until):
    server, busy, wakes = serve(), threading.Event(), []
    wake = server._loop.call_soon_threadsafe
    wake(busy.wait)
    server._loop.call_soon_threadsafe = lambda *call: (wakes.append(call), wake(*call))
    for number in range(200):
        server.show({"kind": "cell", "part": f"part {number % 3}", "content": number})
    assert len(wakes) == 1
    busy.set()
    last = {f"part {k}": max(n for n in range(200) if n % 3 == k) for k in range(3)}
    wait_until(
        lambda: {part["part"]: part["content"] for part in server.state.cell_parts()} == last, "the newest of each part"
    )
    server.show({"kind": "cell", "part": "part 0", "content": "later"})
    wait_until(lambda: "later" in [part["content"] for part in server.state.cell_parts()], "the later change")
    assert len(wakes) == 2


def test_of_the_cell_no_more_is_kept_than_a_cell_has():
    state = DisplayState()
    entered = [
        state.enter({"kind": "cell", "part": f"marker/m/{number}", "content": {}})
        for number in range(MOST_CELL_PARTS + 5)
    ]
    assert entered == [True] * MOST_CELL_PARTS + [False] * 5
    assert state.enter({"kind": "cell", "part": "marker/m/0", "content": None})
    assert len(state.cell_parts()) == MOST_CELL_PARTS - 1


@pytest.mark.parametrize("field", ["net", "request", "argument"])
@pytest.mark.parametrize("text", [r"\ud800", r"a\udfffb", r"\udc00\ud800"])
def test_text_that_no_message_can_carry_is_passed_over(serve, field, text):
    heard = []
    server = serve(operate=lambda wanted: (heard.append(wanted), server.show({"kind": "done"})))
    bad = json.dumps({**ASKED, field: "BAD"}).replace("BAD", text)
    nonsense = ["", "[]", "5", "{}", "[" * 5000, json.dumps({**ASKED, "net": 5}), json.dumps({**ASKED, "net": None})]
    told(server, bad, *nonsense, json.dumps({**ASKED, "net": "\U0001f916"}), kinds=("done",))
    assert heard == [{**ASKED, "net": "\U0001f916"}]


def test_a_request_that_is_too_long_ends_its_own_connection_alone(serve):
    heard = []
    server = serve(operate=heard.append)

    async def talk():
        async with aiohttp.ClientSession() as session, session.ws_connect(socket_of(server)) as viewer:
            await next_change(viewer)
            await viewer.send_str("x" * (LONGEST_REQUEST + 1))
            return (await viewer.receive(timeout=60.0)).type

    assert asyncio.run(talk()) is aiohttp.WSMsgType.CLOSE
    assert asked(server)[0] == 200
    assert heard == []


@pytest.mark.parametrize("sent", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: localhost\r\n"])
def test_a_request_that_is_not_finished_is_ended(serve, monkeypatch, sent):
    monkeypatch.setattr(module, "REQUEST_S", 0.1)
    server = serve()
    with socket.create_connection(("127.0.0.1", port_of(server)), timeout=60.0) as connection:
        connection.sendall(sent)
        assert connection.recv(1000) == b""


def test_connections_that_are_too_many_are_closed_and_later_ones_served(serve, monkeypatch):
    monkeypatch.setattr(module, "MOST_CONNECTIONS", 3)
    assert MOST_VIEWERS < MOST_CONNECTIONS
    server = serve()
    kept, refused = [], []
    for _ in range(6):
        connection = socket.create_connection(("127.0.0.1", port_of(server)), timeout=60.0)
        connection.sendall(b"GET /static/display.css HTTP/1.1\r\nHost: localhost\r\n\r\n")
        try:
            (kept if connection.recv(1) else refused).append(connection)
        except ConnectionResetError:
            refused.append(connection)
    assert (len(kept), len(refused)) == (3, 3)
    for connection in (*kept, *refused):
        connection.close()
    for _ in range(100):
        with contextlib.suppress(aiohttp.ClientError):  # it has not noticed yet
            assert asked(server)[0] == 200
            return
    pytest.fail("nobody is served any more")


def test_more_viewers_than_it_can_serve_are_told_so(serve, monkeypatch):
    monkeypatch.setattr(module, "MOST_VIEWERS", 1)
    assert MOST_VIEWERS > 50
    server = serve()

    async def look():
        async with aiohttp.ClientSession() as session, session.ws_connect(socket_of(server)) as viewer:
            await next_change(viewer)
            with pytest.raises(aiohttp.WSServerHandshakeError) as error:
                await session.ws_connect(socket_of(server))
            return error.value.status

    assert asyncio.run(look()) == 503


def test_the_address_that_it_tells_answers_also_where_the_port_was_taken(serve):
    first = serve()
    second = DisplayServer(port=port_of(first))
    second.start()
    try:
        assert second.url != first.url
        assert json.loads(asked(second, "state.json")[2])["kind"] == "snapshot"
    finally:
        second.stop()


def test_pictures_of_results_are_served_and_nothing_else_of_them(serve, tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    for name in ("7/a.png", "7/report.json", "b.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(name)
    server = serve()
    assert asked(server, "results/7/a.png")[::2] == (200, "7/a.png")
    for path in ("7/none.png", "8/a.png", "7/report.json", "b.png", "7/..%2Fb.png", "7/%2e%2e/b.png", ".%2E/7/a.png"):
        assert asked(server, f"results/{path}")[0] == 404, path


def test_an_allowance_grows_with_time_up_to_its_most():
    now = [0.0]
    allowance = Allowance(2.0, 3, lambda: now[0])
    assert [allowance.take_request() for _ in range(4)] == [True, True, True, False]
    now[0] = 0.6
    assert [allowance.take_request() for _ in range(2)] == [True, False]
    now[0] = 100.0
    assert [allowance.take_request() for _ in range(4)] == [True, True, True, False]


@pytest.mark.parametrize("path", ["x" * 7000, "static/" + "x" * 7000, "static/../site.py", "static/%00", "static/"])
def test_a_path_that_leads_nowhere_is_not_found(serve, path):
    assert asked(serve(), path)[0] == 404


def ask(viewer):
    return viewer.send_json(ASKED)


def ping(viewer):
    return viewer.ping(b"x")


async def flooded(url, send):
    """Have a viewer send without an end; returns what it heard until its connection was ended."""
    heard = []
    async with aiohttp.ClientSession() as session, session.ws_connect(url) as viewer:

        async def flood():
            with contextlib.suppress(ConnectionError, aiohttp.ClientError):
                while not viewer.closed:
                    await send(viewer)
                    await asyncio.sleep(0)

        flooding = asyncio.create_task(flood())
        while (message := await viewer.receive(timeout=60.0)).type is aiohttp.WSMsgType.TEXT:
            heard.append(json.loads(message.data))
        flooding.cancel()
        await asyncio.gather(flooding, return_exceptions=True)
    return heard


@pytest.mark.parametrize("send", [ask, ping])
@pytest.mark.parametrize("apart", [False, True])
def test_a_viewer_that_sends_too_much_is_told_so_and_ended(serve, send, apart):
    server = serve(apart=apart)
    heard = asyncio.run(flooded(socket_of(server), send))
    assert heard[-1]["message"] == TOO_FAST
    assert asked(server)[0] == 200


def test_a_flood_of_many_viewers_reaches_nets_at_the_rate_of_the_page(serve):
    heard = []
    server = serve(operate=heard.append, apart=True)

    async def flood():
        return await asyncio.gather(*(flooded(socket_of(server), ask) for _ in range(20)))

    began = monotonic()
    told_all = asyncio.run(flood())
    assert any(answer.get("message") == TOO_MANY for told_one in told_all for answer in told_one)
    assert all(told_one[-1]["message"] == TOO_FAST for told_one in told_all)
    assert PAGE_AT_ONCE <= len(heard) <= PAGE_AT_ONCE + PAGE_PER_S * (monotonic() - began) + 1


def test_what_one_viewer_may_not_do_is_told_to_that_viewer_alone(serve):
    server = serve()

    async def talk():
        async with (
            aiohttp.ClientSession() as session,
            session.ws_connect(socket_of(server)) as other,
            session.ws_connect(socket_of(server)) as viewer,
        ):
            for each in (other, viewer):
                await next_change(each)
            await viewer.send_json(ASKED)
            answer = await next_change(viewer)
            server.show({"kind": "done"})
            return answer["message"], (await next_change(other))["kind"]

    assert asyncio.run(talk()) == (READ_ONLY, "done")


def test_a_process_of_its_own_shows_what_the_display_shows(serve, wait_until):
    heard = []
    server = serve(operate=lambda wanted: (heard.append(wanted), server.show({"kind": "done"})), apart=True)
    server.state.enter({"kind": "net", "net": "a", "node": "/node", "description": "the first"})

    def shown():
        return json.loads(asked(server, "state.json")[2])

    assert shown()["nets"] == [{"net": "a", "node": "/node", "description": "the first"}]
    snapshot, done = told(server, json.dumps(ASKED), kinds=("done",))
    assert (snapshot["operable"], done, heard) == (True, {"kind": "done"}, [ASKED])
    server.show({"kind": "net", "net": "b", "node": "/node"})

    wait_until(lambda: [net["net"] for net in shown()["nets"]] == ["a", "b"], "the second net")


def children(module_name):
    """Processes that this one has started to run a module."""
    found = []
    for task in Path("/proc/self/task").iterdir():
        numbers = ""
        with contextlib.suppress(OSError):  # a thread may end meanwhile, and so may a child
            numbers = (task / "children").read_text()
        for number in numbers.split():
            with contextlib.suppress(OSError):
                if module_name.encode() in Path(f"/proc/{number}/cmdline").read_bytes():
                    found.append(int(number))
    return found


def test_a_page_whose_process_dies_comes_back_and_ends_with_the_display(serve, wait_until):
    server = serve(apart=True)
    assert not children(WEB_PROCESS), "it begins with the first visitor"
    assert asked(server)[0] == 200
    [process] = children(WEB_PROCESS)
    subprocess.run(["kill", "-KILL", str(process)], check=True)
    wait_until(lambda: process not in children(WEB_PROCESS), "the end of the process")
    assert asked(server)[0] == 200
    server.stop()
    assert not children(WEB_PROCESS)


CLICKS = """
import { showControls } from "./operate.mjs";
const made = () => ({ dataset: {}, parts: [], addEventListener() {}, append() {},
                      replaceChildren(...parts) { this.parts = parts; } });
globalThis.document = { createElement: made };
const element = made(), marking = { mode: "step", paused: false, proposed: [], in_doubt: [], sequence: 1 };
const kept = (shown, changes) => {
  const before = element.parts;
  showControls(element, shown, "n", { ...marking, ...changes }, [], () => {});
  return before === element.parts;
};
console.log(JSON.stringify([
  kept(true, {}), kept(true, { sequence: 2, tokens: { p: 1 } }), kept(true, { paused: true }),
  kept(true, { paused: true, proposed: ["t"] }), kept(true, { mode: "automatic" }), kept(true, { in_doubt: ["t"] }),
  kept(false, {}), kept(false, { sequence: 3 }), element.parts.length,
]));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, which runs the scripts of the page")
def test_the_controls_of_a_net_stay_while_it_fires(tmp_path):
    """A click whose button is made anew between press and release is lost."""
    (tmp_path / "operate.mjs").write_text((module.STATIC / "operate.js").read_text())
    (tmp_path / "clicks.mjs").write_text(CLICKS)
    done = subprocess.run(["node", tmp_path / "clicks.mjs"], check=True, capture_output=True, text=True)
    assert json.loads(done.stdout) == [False, True, False, False, False, False, False, True, 0]


PLAYS = """
import { Recording } from "./recording.js";
let now = 0, frames = [], answers = [];
const anything = () => new Proxy(() => {}, { get: (_, name) => (name === Symbol.toPrimitive ? () => 1 : anything()),
                                             set: () => true, apply: () => anything() });
globalThis.document = { getElementById: (id) => (id === "rate" ? { value: "1" } : anything()), body: anything() };
globalThis.addEventListener = () => {};
globalThis.devicePixelRatio = 1;
Object.defineProperty(globalThis, "performance", { value: { now: () => now } });
globalThis.requestAnimationFrame = (draw) => frames.push(draw);
globalThis.fetch = () => new Promise((done) => answers.push(() => done({
  ok: true, json: async () => ({ at: 0, firing: 0, steps: [], more: false }) })));
const settle = () => new Promise((done) => setTimeout(done));
const answered = async () => { for (const answer of answers.splice(0)) answer(); await settle(); };
const passed = (seconds) => {  // how far it has come after so many seconds of frames
  const before = recording.at;
  for (const end = now + 1000 * seconds; now < end;) { now += 20; for (const draw of frames.splice(0)) draw(now); }
  return Math.round(100 * (recording.at - before)) / 100;
};
const recording = new Recording(() => {}, () => {}, () => {}, () => {}), found = [];
recording.overview = { end: 100, firings: 0, rows: [] };
recording.at = 100;
recording.play(!recording.playing); recording.play(!recording.playing);  // a double click at the end
await answered();
found.push(passed(1));
recording.play(false); recording.play(true);  // within a frame
found.push(passed(1));
recording.play(false);
found.push(passed(1));
recording.at = 100;
recording.play(true); recording.seek({ firing: 0 });  // who goes to the beginning, meanwhile, does not want to play
await answered();
found.push(passed(1));
recording.play(true);
found.push(passed(1));
console.log(JSON.stringify(found));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, which runs the scripts of the page")
def test_a_recording_plays_at_its_pace_however_often_play_is_clicked(tmp_path):
    (tmp_path / "package.json").write_text('{"type": "module"}')
    for name in ("player.js", "recording.js"):
        shutil.copy(module.STATIC / name, tmp_path)
    (tmp_path / "plays.mjs").write_text(PLAYS)
    done = subprocess.run(["node", tmp_path / "plays.mjs"], check=True, capture_output=True, text=True)
    assert json.loads(done.stdout) == [1.0, 1.0, 0.0, 0.0, 1.0]


def taken(viewer):
    """The pieces that wait for a viewer, as lists of changes."""
    pieces = []
    while not viewer.unsent.empty():
        pieces.append([json.loads(line) for line in viewer.unsent.get_nowait().decode().split("\n")])
    return pieces


def test_who_comes_while_nets_fire_is_told_each_firing_once():
    """What one thread has told of, and the thread of the server has not yet shown, is in no snapshot."""
    state = DisplayState()

    async def fire():
        viewers = Viewers(state)
        other = viewers.enter()
        viewers.show({"kind": "firing", "net": "n", "sequence": 1})
        viewer = viewers.enter()
        viewers.show({"kind": "firing", "net": "n", "sequence": 2})
        condition = {"state": "motion", "stale": False}
        for _ in range(2):
            viewers.show({"kind": "mcs", **condition})
        viewers.send()
        return taken(viewer), taken(other)

    [[snapshot], changes], of_other = asyncio.run(fire())
    firings = [change for change in changes if change["kind"] == "firing"]
    assert [firing["sequence"] for firing in [*snapshot["firings"], *firings]] == [1, 2]
    assert len(changes) == 2, "what is nothing new is not told"
    assert [change["kind"] for piece in of_other for change in piece] == ["snapshot", "firing", "firing", "mcs"]


def test_changes_that_follow_each_other_go_in_one_piece_with_the_newest_marking_alone():
    state = DisplayState()

    async def fire():
        viewers = Viewers(state)
        both = viewers.enter(), viewers.enter(at_cell=True)
        for each in both:
            await each.unsent.get()
        for number in range(3):
            viewers.show({"kind": "firing", "net": "n", "sequence": number})
            viewers.show({"kind": "marking", "net": "n", "sequence": number})
            viewers.show({"kind": "cell", "part": "joints", "content": number})
        return [[json.loads(line) for line in (await each.unsent.get()).decode().split("\n")] for each in both]

    viewer, at_cell = asyncio.run(fire())
    assert [(one["kind"], one["sequence"]) for one in viewer] == [
        ("firing", 0), ("firing", 1), ("firing", 2), ("marking", 2)]  # fmt: skip
    assert [one["content"] for one in at_cell if one["kind"] == "cell"] == [2]


def test_a_viewer_that_takes_nothing_misses_changes_and_gets_the_state_later():
    state = DisplayState()

    async def fire():
        viewers = Viewers(state)
        viewer = viewers.enter(at_cell=True)
        for number in range(MOST_UNSENT + 9):
            viewers.show({"kind": "firing", "net": "n", "sequence": number})
            viewers.send()
        other = viewers.enter(at_cell=True)
        viewers.show({"kind": "cell", "part": "joints", "content": 1})
        viewers.send()
        assert len(taken(viewer)) == MOST_UNSENT
        state_again = (await viewer.unsent.get()).decode().split("\n")
        viewers.show({"kind": "firing", "net": "n", "sequence": -1})
        viewers.send()
        return [json.loads(line) for line in state_again], taken(viewer), taken(other)

    state_again, later, of_other = asyncio.run(fire())
    assert [one["kind"] for one in state_again] == ["snapshot", "cell"]
    assert state_again[0]["firings"][-1]["sequence"] == MOST_UNSENT + 8
    assert [one["sequence"] for [one] in later] == [-1]
    assert [one["kind"] for [one] in of_other] == ["snapshot", "cell", "firing"]


def test_a_viewer_that_takes_nothing_sees_the_cell_once_it_takes_something():
    state = DisplayState()

    async def look():
        viewers = Viewers(state)
        viewers.show({"kind": "cell", "part": "joints", "content": 1})
        viewer = viewers.enter()
        while not viewer.unsent.full():
            viewers.show({"kind": "firing", "net": "n", "sequence": 1})
            viewers.send()
        viewers.look(viewer, at_cell=True)
        taken(viewer)
        return (await viewer.unsent.get()).decode().split("\n")

    assert [json.loads(line)["kind"] for line in asyncio.run(look())] == ["snapshot", "cell"]


@pytest.mark.parametrize("length", [30, 125, 126, 2**16 - 1, 2**16, 2**20])
def test_a_message_of_any_length_reaches_browsers(serve, length):
    server = serve()

    async def talk():
        async with aiohttp.ClientSession() as session, session.ws_connect(socket_of(server), compress=15) as viewer:
            await next_change(viewer)
            server.show({"kind": "x" * (length - len('{"kind": ""}'))})
            return await viewer.receive_str(timeout=60.0)

    assert len(asyncio.run(talk())) == length


def test_a_refusal_goes_with_the_next_net_of_its_name_and_the_last_ones_are_kept():
    state = DisplayState()

    def refused():
        return [each["net"] for each in state.snapshot()["refusals"]]

    for number in range(2 * REFUSALS_KEPT):
        state.enter({"kind": "refusal", "net": f"n{number}", "message": "it can stand still", "counterexample": {}})
    assert refused() == [f"n{number}" for number in range(REFUSALS_KEPT, 2 * REFUSALS_KEPT)]
    state.enter({"kind": "net", "net": "n25", "node": "/node"})
    state.enter({"kind": "gone", "net": "n26"})
    state.enter({"kind": "refusal", "net": "n21", "message": "again", "counterexample": {}})
    assert not {"n25", "n26"} & set(refused())
    assert refused()[-1] == "n21"


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("0.0.0.0", "http://localhost:8080/"),
        ("::", "http://localhost:8080/"),
        ("::1", "http://[::1]:8080/"),
        ("lab", "http://lab:8080/"),
    ],
)
def test_the_address_is_one_that_a_browser_takes(host, url):
    assert DisplayServer(host=host).url == url


@pytest.mark.parametrize("host", ["x" * 300, "a..b", "a b", "a\0b", "\ud800"])
def test_what_is_no_name_of_a_computer_is_refused_with_it(host):
    with pytest.raises(LinkError, match="cannot serve the display on"):
        DisplayServer(host, 0).start()


def test_behind_the_last_port_there_is_none_to_try():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 65535))
        with pytest.raises(LinkError, match="ports 65535 to 65535 are all in use"):
            DisplayServer(port=65535).start()
