"""Functions of a user's module run in a thread of their own: they may block, and what they write comes back."""

import sys
import threading
from types import SimpleNamespace

import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core.errors import DataError
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_pnt.errors import NetFileError
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_node.rerun.rerun import NodeRerun
from im_pnt_node.rerun.stream import streams_of
from im_pnt_node.ros.node import PntNode
from im_pnt_node.ros.rerun import RosMessages, RosWorld

NET = """
net: bench
commands:
  weigh: {arguments: {mass: {type: number}}}
  count: {}
places:
  {scale: {tokens: 1, resource: true}, seen: , weighed: , odd: , hand: {tokens: 1, resource: true}, counted: , missed: }
transitions:
  look: {symbol: weigh, in: scale, out: seen, action: "lab_functions:look", on_failure: odd}
  weigh: {in: seen, out: weighed, action: "lab_functions:weigh", on_failure: odd}
  done: {in: weighed, out: scale, emit: weigh_done}
  give_up: {in: odd, out: scale, emit: weigh_failed}
  count: {symbol: count, in: hand, out: counted, action: note, on_failure: missed}
  counted: {in: counted, out: hand, emit: count_done}
  miscounted: {in: missed, out: hand, emit: count_failed}
"""


ENDS = ("done", "give_up", "counted")


def fired(texts):
    """The transitions that have fired, of what a node has told."""
    items = [item for stream in streams_of(texts) for turn in stream.turns for item in turn.items]
    return [item[2][1] for item in items if item[0] == "net" and item[2][0] == "fire"]


class Lab:
    """The user's module."""

    def __init__(self):
        self.begun, self.go_on, self.threads, self.stopped = threading.Event(), threading.Event(), [], []

    def look(self, ctx):
        ctx.memory["looked"] = True
        ctx.memory["passing"] = ctx.memory.pop("passing", 0)

    def weigh(self, ctx):
        self.threads.append(threading.current_thread())
        ctx.on_cancel(lambda: self.stopped.append(threading.current_thread()))
        ctx.progress("weighing", 0.5)
        ctx.result["mass"] = 2.0 * ctx.command.arguments["mass"]
        ctx.memory["weighed"] = ctx.memory["looked"]
        del ctx.memory["passing"]
        self.begun.set()
        while not self.go_on.wait(0.02):
            if ctx.cancelled:
                raise DataError("the scale was needed")
        if ctx.command.arguments["mass"] < -5.0:
            sys.exit("no scale")
        if ctx.command.arguments["mass"] < 0.0:
            raise ValueError("a mass is not negative")


@pytest.fixture
def lab(monkeypatch):
    lab = Lab()
    module = SimpleNamespace(look=lab.look, weigh=lab.weigh, heavy=lambda ctx: True)
    monkeypatch.setitem(sys.modules, "lab_functions", module)
    return lab


def made(_host):
    """What the node has registered itself."""
    from im_pnt.execution.functions import Functions

    return Functions({"note": note})


def note(ctx):
    ctx.memory["counted"] = True


@pytest.fixture
def bench(lab, ros, tmp_path, wait_until):
    """The node, what it tells of its missions, and ``run(symbol, **arguments)``."""
    (tmp_path / "bench.yaml").write_text(NET, encoding="utf-8")
    texts = []
    listener = GuardedNode("listener")
    listener.create_subscription(String, "/pnt/events", lambda message: texts.append(message.data), qos.EVENTS)
    ros(listener)
    given = {"standalone": True, "journal_dir": str(tmp_path / "journal")}
    node = PntNode(
        "bench",
        [tmp_path / "bench.yaml"],
        {"note": note},
        verifier=verify_to_load,
        made_by=f"{__name__}:made",
        parameter_overrides=[Parameter(name, value=value) for name, value in given.items()],
    )
    ros(node)
    wait_until(lambda: texts, "the state of the net")

    def run(symbol, **arguments):
        outcomes, told, numbers = [], [], []

        def listener(_transition, text, _fraction):
            told.extend([text] if text else [])
            raise RuntimeError("a listener that breaks")

        async def work():
            outcomes.append(await node.commands.run(symbol, arguments, listener, numbers.append))

        node.spawn(work())
        return SimpleNamespace(outcomes=outcomes, told=told, numbers=numbers)

    return SimpleNamespace(node=node, run=run, texts=texts)


def test_a_function_may_block_while_its_node_goes_on_and_what_it_writes_comes_back(bench, lab, wait_until):
    weighing = bench.run("weigh", mass=1.5)
    wait_until(lab.begun.is_set, "the function to begin")
    counting = bench.run("count")
    wait_until(lambda: counting.outcomes, "another command, meanwhile")
    assert not weighing.outcomes
    wait_until(lambda: weighing.told, "its progress")
    lab.go_on.set()
    wait_until(lambda: weighing.outcomes, "its end")
    (outcome,) = weighing.outcomes
    assert (outcome.success, outcome.results) == (True, {"mass": 3.0})
    assert weighing.told == ["weighing"]
    assert lab.threads[0] is not threading.main_thread()
    assert lab.stopped == []


@pytest.mark.parametrize(("mass", "said"), [(-1.0, "a mass is not negative"), (-9.0, "called sys.exit: no scale")])
def test_its_failure_and_what_it_wrote_before_are_those_of_its_command(bench, lab, wait_until, mass, said):
    lab.go_on.set()
    weighing = bench.run("weigh", mass=mass)
    wait_until(lambda: weighing.outcomes, "its end")
    (outcome,) = weighing.outcomes
    assert not outcome.success
    assert said in outcome.status.message


def test_it_learns_that_it_is_cancelled(bench, lab, wait_until):
    weighing = bench.run("weigh", mass=1.5)
    wait_until(lab.begun.is_set, "the function to begin")
    bench.node.commands.cancel(weighing.numbers[0])
    wait_until(lambda: weighing.outcomes, "its end")
    assert not weighing.outcomes[0].success
    wait_until(lambda: lab.stopped, "what is called when it is cancelled")
    assert lab.stopped[0] is not lab.threads[0]


def test_its_mission_is_run_again_without_calling_it(bench, lab, wait_until):
    lab.go_on.set()
    runs = [bench.run("weigh", mass=mass) for mass in (1.5, -1.0, 2.5)] + [bench.run("count") for _ in range(3)]
    wait_until(lambda: all(run.outcomes for run in runs), "all commands")
    wait_until(lambda: len([name for name in fired(bench.texts) if name in ENDS]) == len(runs), "their last events")
    (stream,) = streams_of(bench.texts)
    called = len(lab.threads)
    compared = NodeRerun(stream, RosWorld(), RosMessages(), {}).run()
    assert (compared.nets, len(lab.threads)) == ({"bench"}, called)
    assert compared.firings >= 20


@pytest.mark.parametrize(
    ("guard", "said"),
    [("lab_functions:nothing", "guard function 'lab_functions:nothing' cannot be loaded"), ("cancelld", "cancelled")],
)
def test_a_guard_that_is_not_there_is_refused_with_its_line_and_one_that_is_asked(bench, guard, said, wait_until):
    text = NET.replace("net: bench", "net: other").replace("weigh_", "lift_").replace("symbol: weigh,", "symbol: lift,")
    text = text.replace("weigh: {arguments", "lift: {arguments").replace("count", "tally")
    text = text.replace("action: note", 'action: "lab_functions:look"')
    ends = []

    async def load(guard):
        try:
            await bench.node.load_net(parse_net(text.replace("in: weighed, ", f'in: weighed, guard: "{guard}", ')))
        except NetFileError as error:
            ends.append(str(error))
        else:
            ends.append("loaded")

    bench.node.spawn(load(guard))
    wait_until(lambda: ends, "what comes of the net")
    assert said in ends[0]
    bench.node.spawn(load("lab_functions:heavy"))
    wait_until(lambda: len(ends) == 2, "what comes of the right one")
    assert ends[1] == "loaded"


def test_a_module_may_take_long_to_be_imported_while_its_node_goes_on(bench, monkeypatch, tmp_path, wait_until):
    gate = SimpleNamespace(reached=threading.Event(), go_on=threading.Event())
    monkeypatch.setitem(sys.modules, "lab_gate", gate)
    (tmp_path / "lab_slow.py").write_text(
        "import lab_gate\nlab_gate.reached.set()\nlab_gate.go_on.wait(60)\ndef go(ctx):\n    pass\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    net = parse_net("""
net: slow
places: {idle: 1, over: }
transitions:
  go: {symbol: go, in: idle, out: over, action: "lab_slow:go", on_failure: over}
  end: {in: over, out: idle, emit: go_done}
""")
    loaded = []

    async def load():
        loaded.append(await bench.node.load_net(net))

    bench.node.spawn(load())
    wait_until(gate.reached.is_set, "the import to begin")
    counting = bench.run("count")
    wait_until(lambda: counting.outcomes, "a command, meanwhile")
    assert not loaded
    gate.go_on.set()
    wait_until(lambda: loaded, "the net")
