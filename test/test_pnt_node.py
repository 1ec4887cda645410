"""Nets in several processes: requests, results, failures, cancellation, and the death of a coordinator."""

import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import rclpy

from im_core import clock
from im_core.errors import DataError
from im_core.ros import qos
from im_core.ros.run import main, spin_in_thread
from im_msgs.msg import Firing
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

NETS = {
    **{name: (Path(__file__).parent / "nets" / f"{name}.yaml").read_text() for name in ("front", "middle")},
    "back": """
net: back
places: {wanted: , planned: , impossible: }
services: {plan: {entry: wanted, done: planned, failed: impossible}}
transitions:
  think: {in: wanted, out: planned, action: think, on_failure: impossible}
""",
}


def think(ctx):
    """The only action of these nets: succeeds, fails or waits, as the command's arguments say."""
    how = ctx.command.arguments["how"]
    if how == "fail":
        raise DataError("there is no way through", obstacle="table")
    ctx.result["answer"] = 42
    return wait_for_cancel(ctx) if how == "wait" else None


async def wait_for_cancel(ctx):
    promise = NODES["back"].promise()
    ctx.on_cancel(lambda: promise.set_result(None))
    await promise
    raise DataError("stopped thinking")


NODES = {}


def make_node(name: str, folder: Path) -> PntNode:
    node = PntNode(
        name,
        [folder / f"{name}.yaml"],
        {"think": think},
        verifier=verify_to_load,
        parameter_overrides=[rclpy.parameter.Parameter("standalone", value=True)],
    )
    NODES[name] = node
    return node


def start(name: str, folder: Path) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, __file__, name, str(folder)])


def run(node: PntNode, how: str, seconds: float = 60.0, cancel_when: Callable[[], bool] | None = None):
    """Runs one command from a thread that does not spin."""
    ended = threading.Event()
    outcome = []
    numbers = []

    async def work():
        outcome.append(await node.commands.run("serve", {"how": how}, started=numbers.append))
        ended.set()

    node.executor.create_task(work())
    node.wake()
    if cancel_when is not None:
        until(lambda: numbers and cancel_when())
        node.commands.cancel(numbers[0])
    assert ended.wait(seconds), f"command serve({how}) did not end in {seconds} s"
    return outcome[0]


def until(condition: Callable[[], object]) -> None:
    deadline = clock.monotonic() + 60.0
    while not condition():
        assert clock.monotonic() < deadline, "waited in vain"
        clock.sleep(0.02)


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nets")
    for name, text in NETS.items():
        (folder / f"{name}.yaml").write_text(text)
    processes = {name: start(name, folder) for name in ("middle", "back")}
    rclpy.init()
    node = make_node("front", folder)
    firings = []
    node.create_subscription(Firing, "/pnt/firings", firings.append, qos.EVENTS)
    with spin_in_thread(node):
        until(lambda: None not in map(node.heartbeats.incarnation, ("middle", "back")))
        until(lambda: node.count_publishers("/pnt/firings") == len(NETS))
        yield node, firings, processes, folder
    rclpy.try_shutdown()
    for process in processes.values():
        process.send_signal(signal.SIGINT)
    for process in processes.values():
        process.wait(60.0)


def test_a_request_passes_through_three_processes_and_its_result_is_success(machine):
    node, firings, _, _ = machine
    outcome = run(node, "succeed")
    assert outcome.success
    through = {("back", "think", Firing.START), ("middle", "plan", Firing.END), ("front", "ask", Firing.END)}
    until(lambda: through <= {(f.net, f.transition, f.phase) for f in firings})
    for net in NETS:
        sequences = [f.sequence for f in firings if f.net == net]
        assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))


def test_a_failure_travels_back_with_its_code_message_and_facts(machine):
    outcome = run(machine[0], "fail")
    assert not outcome.success
    assert outcome.status.code == "data"
    assert outcome.status.message == "there is no way through"
    assert {fact.key: fact.value for fact in outcome.status.facts} == {"obstacle": '"table"'}


def test_cancelling_reaches_the_process_where_the_action_runs(machine):
    node, firings, _, _ = machine
    begun = len(firings)

    def thinking():
        return ("think", Firing.START) in [(f.transition, f.phase) for f in firings[begun:]]

    outcome = run(node, "wait", cancel_when=thinking)
    assert outcome.status.message == "stopped thinking"
    assert run(machine[0], "succeed").success


def test_a_command_ends_with_who_is_missing_when_a_coordinator_is_killed(machine):
    node, _, processes, folder = machine
    threading.Timer(0.5, processes["back"].kill).start()
    outcome = run(node, "wait")
    assert "back is missing" in outcome.status.message
    processes["back"] = start("back", folder)
    until(lambda: run(node, "succeed").success)


if __name__ == "__main__":
    name, folder = sys.argv[1:]
    sys.exit(main(lambda: make_node(name, Path(folder)), args=[]))
