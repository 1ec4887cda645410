"""Nets under the hands of an operator: paused, stepped, confirmed; actions in doubt resolved; nets replaced."""

import json
import math
import threading
from pathlib import Path

import pytest
import rclpy
from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core import clock
from im_core.errors import ImError
from im_core.names import results_dir
from im_core.ros import qos
from im_core.ros.calls import call_blocking
from im_core.ros.node import ManagedNode
from im_core.ros.run import spin_in_thread
from im_msgs.msg import Marking, NetRefusal, StrategyChoice
from im_msgs.srv import ControlNet, NetValues
from im_pnt.errors import JournalError
from im_pnt.execution.events import Answer, Outcome
from im_pnt.netfile import parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_display.page.messages import counterexample
from im_pnt_node.journal.strategies import read_experience
from im_pnt_node.ros.commands.commands import NOT_OBEYED
from im_pnt_node.ros.node import PntNode
from support.loop import in_loop

WALKER = """
net: walker
places: {idle: 1, here: , there: , lost: }
transitions:
  go: {in: idle, out: here, symbol: go}
  walk: {in: here, out: there, action: walk, timeout: 0.2, on_failure: lost}
  back: {in: there, out: idle, emit: go_done}
  give_up: {in: lost, out: idle, emit: go_failed}
"""
LAMP = """
net: lamp
places: {dark: 1, bright: , broken: }
rest: [dark, bright]
transitions:
  light: {in: dark, out: bright, symbol: light, emit: light_done, action: press, strategy: {}, on_failure: broken}
  shine: {in: dark, out: bright, symbol: light, emit: light_done, action: press, strategy: {}, on_failure: broken}
  mend: {in: broken, out: dark, emit: light_failed}
  dim: {in: bright, out: dark, symbol: dim, emit: dim_done}
"""
BIN = """
net: bin
places: {thrown: {remote: true}}
transitions:
  burn: {in: thrown, out: []}
"""
THROWER = """
net: thrower
places: {hand: 1}
transitions:
  throw: {in: hand, out: [hand, bin.thrown], symbol: throw, emit: throw_done}
"""


SPIN = "net: spin\nplaces: {a: 1, b: }\ntransitions: {to: {in: a, out: b}, fro: {in: b, out: a}}\n"


class Operator(ManagedNode):
    """Asks for what an operator wants, and sees what the page shows."""

    def __init__(self, **kwargs):
        super().__init__("operator", **kwargs)
        self.markings, self.refusals, self.choices, self.breakpoints = {}, [], [], []
        self.create_subscription(String, "/pnt/breakpoints", self.breakpoints.append, qos.LATCHED_MANY)
        self.values = self.create_client(NetValues, "/walker/net_values")
        self.create_subscription(Marking, "/pnt/markings", self._mark, qos.LATCHED_MANY)
        self.create_subscription(NetRefusal, "/pnt/refusals", self.refusals.append, qos.LATCHED_MANY)
        self.create_subscription(StrategyChoice, "/pnt/strategies", self.choices.append, qos.EVENTS)
        self.control = self.create_client(ControlNet, "/walker/control_net")

    def _mark(self, message):
        self.markings[message.net] = message

    def tokens(self, net="walker"):
        message = self.markings.get(net)
        return dict(zip(message.places, message.tokens, strict=True)) if message else {}

    def ask(self, request, argument="", net="walker"):
        asked = ControlNet.Request(net=net, request=request, argument=argument)
        return call_blocking(self.control, asked, 60.0, "test")

    def until(self, condition, what, seconds=60.0):
        deadline = clock.monotonic() + seconds
        while not condition():
            assert clock.monotonic() < deadline, f"waited {seconds} s for {what}, in vain; {self.markings}"
            clock.sleep(0.02)


class Walker(PntNode):
    """Walks at once, or for ever."""

    def __init__(self, folder, **kwargs):
        self.hold, self.held = False, []
        super().__init__(
            "walker",
            [folder / f"{name}.yaml" for name in ("walker", "lamp", "bin")],
            {"walk": self.walk, "press": lambda ctx: None},
            asks={"walk": lambda ctx: Answer(Outcome.RUNNING, asked="its legs")},
            verifier=verify_to_load,
            **kwargs,
        )

    async def walk(self, ctx):
        if self.hold:
            self.held.append(self.promise())
            await self.held[-1]

    def go(self, symbol="go"):
        """Gives a command; returns the list that will hold its outcome."""
        outcomes = []

        async def work():
            outcomes.append(await self.commands.run(symbol))

        self.executor.create_task(work())
        self.wake()
        return outcomes

    def load(self, text, patience_s=0.0):
        """Loads a net; returns what it is refused for, or an empty string."""
        ended, said = threading.Event(), []

        async def work():
            try:
                await self.load_net(parse_net(text), patience_s)
            except ImError as error:
                said.append(error.message)
            ended.set()

        self.executor.create_task(work())
        self.wake()
        assert ended.wait(60.0)
        return said[0] if said else ""


def make_walker(folder):
    parameters = [Parameter("standalone", value=True), Parameter("journal_dir", value=str(folder / "journal"))]
    return Walker(folder, parameter_overrides=parameters)


@pytest.fixture
def machine(tmp_path, monkeypatch):
    monkeypatch.setenv("IM_RESULTS_DIR", str(tmp_path))
    for name, text in (("walker", WALKER), ("lamp", LAMP), ("bin", BIN)):
        (tmp_path / f"{name}.yaml").write_text(text)
    rclpy.init()
    operator = Operator(parameter_overrides=[Parameter("standalone", value=True)])
    walker = make_walker(tmp_path)
    with spin_in_thread(operator, walker):
        operator.until(lambda: operator.tokens() == {"idle": 1}, "the net")
        operator.control.wait_for_service(60.0)
        clock.sleep(0.3)
        yield operator, walker
        for promise in walker.held:
            promise.set_result(None)
        clock.sleep(0.1)
    rclpy.try_shutdown()


def test_a_paused_net_starts_nothing_until_it_is_resumed(machine):
    operator, walker = machine
    answer = operator.ask("pause")
    assert answer.success
    assert answer.state == "automatic, paused: idle=1"
    outcomes = walker.go()
    clock.sleep(0.3)
    assert operator.tokens() == {"idle": 1}
    assert operator.markings["walker"].paused
    operator.ask("resume")
    operator.until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success


def test_a_net_that_never_comes_to_rest_is_paused_and_leaves_the_others_their_time(machine):
    operator, walker = machine
    assert walker.load(SPIN) == ""
    operator.until(lambda: "spin" in operator.markings and operator.markings["spin"].paused, "the pause", 30.0)
    outcomes = walker.go()
    operator.until(lambda: outcomes, "the end of the command of another net")
    assert outcomes[0].success


def test_a_net_that_never_comes_to_rest_is_replaced_before_it_is_paused(machine):
    operator, walker = machine
    assert walker.load(SPIN) == ""
    assert walker.load(SPIN.replace("fro:", "back:")) == ""
    operator.until(lambda: operator.markings["spin"].paused, "the pause", 30.0)


@pytest.mark.parametrize("has", ["delay: 0.000001", "action: press, on_failure: a"])
def test_a_net_that_waits_for_next_to_nothing_leaves_the_others_their_time(machine, has):
    operator, walker = machine
    assert walker.load(f"net: ticking\nplaces: {{a: 1}}\ntransitions: {{t: {{in: a, out: a, {has}}}}}\n") == ""
    for _ in range(10):
        outcomes = walker.go()
        operator.until(lambda ended=outcomes: ended, "the end of the command of another net")
        assert outcomes[0].success


def test_step_by_step_each_request_fires_one_transition(machine):
    operator, walker = machine
    assert operator.ask("step").state.startswith("step: ")
    outcomes = walker.go()
    for place in ("here", "there", "idle"):
        operator.until(lambda: walker.exchange.nets["walker"].operator.may_step, "something to be allowed")
        operator.ask("step")
        operator.until(lambda wanted=place: operator.tokens() == {wanted: 1}, f"a token on {place}")
    operator.until(lambda: outcomes, "the end of the command")
    assert operator.markings["walker"].mode == "step"


def test_a_step_that_nothing_waits_for_is_refused(machine):
    operator, walker = machine
    assert operator.ask("step").success  # that is the mode
    refused = operator.ask("step")
    assert (refused.success, refused.message) == (
        False, "net walker takes no step: nothing is enabled that waits for one",
    )  # fmt: skip
    outcomes = walker.go()
    operator.until(lambda: walker.exchange.nets["walker"].operator.may_step, "something to be allowed")
    operator.ask("pause")
    assert operator.ask("step").message == "net walker takes no step: it is paused"
    operator.ask("resume")
    operator.ask("automatic")
    operator.until(lambda: outcomes, "the end of the command")


def test_an_operator_is_told_what_outlives_the_node(machine, monkeypatch):
    operator, walker = machine

    def full(batch):
        raise JournalError("the journal cannot be written: No space left on device", file="journal")

    with monkeypatch.context() as patch:
        patch.setattr(walker._loop.journal._log, "append", full)
        answer = operator.control.call_async(ControlNet.Request(net="walker", request="pause"))
        operator.until(lambda: walker.exchange.nets["walker"].paused, "the pause")
        clock.sleep(0.3)
        assert not answer.done()
    operator.until(answer.done, "the answer")
    assert answer.result().success
    assert answer.result().state == "automatic, paused: idle=1"


def test_under_supervision_each_firing_is_proposed_and_confirmed(machine):
    operator, walker = machine
    operator.ask("supervised")
    refused = operator.ask("confirm")
    assert (refused.success, refused.message) == (False, "nothing waits to be confirmed in net walker")
    outcomes = walker.go()
    for transition in ("go", "walk", "back"):
        operator.until(lambda wanted=transition: operator.markings["walker"].proposed == [wanted], f"{transition}")
        assert f"known: {transition}" in operator.ask("confirm", "nothing").message
        assert operator.ask("confirm", transition).success
    operator.until(lambda: outcomes, "the end of the command")


def test_before_a_breakpoint_a_command_waits_with_its_values(machine):
    operator, walker = machine
    assert "did you mean 'walk'" in operator.ask("break", "wlk").message
    assert "there is no breakpoint 'walk'" in operator.ask("clear", "walk").message
    assert operator.ask("break", "walk").success
    operator.until(lambda: operator.breakpoints, "the breakpoint")
    assert json.loads(operator.breakpoints[-1].data) == {"node": "/walker", "breakpoints": {"walker": ["walk"]}}
    outcomes = walker.go()
    operator.until(lambda: operator.markings["walker"].proposed == ["walk"], "the token before the transition")

    def values(part):
        return call_blocking(operator.values, NetValues.Request(net="walker", part=part), 60.0, "test")

    told = json.loads(values("here").json)
    assert told == {"count": 1, "tokens": [{"command": 1, "symbol": "go", "arguments": {}, "results": {}}]}
    assert json.loads(values("walk").json) == {"running": [], "answers": []}
    assert "did you mean 'here'" in values("her").message
    assert operator.ask("confirm", "walk").success
    operator.until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success


def test_a_command_whose_cancel_came_too_late_says_that_it_was_asked(machine):
    operator, walker = machine
    operator.ask("break", "back")
    outcomes = walker.go()
    operator.until(lambda: operator.markings["walker"].proposed == ["back"], "the token before the last transition")
    in_loop(walker, walker.commands.cancel, 1)
    operator.ask("confirm")
    operator.until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success
    assert outcomes[0].status.message == NOT_OBEYED
    operator.ask("clear", "back")
    assert walker.commands.ended[1].message == NOT_OBEYED


def test_a_breakpoint_outlives_its_node(tmp_path):
    for name, text in (("walker", WALKER), ("lamp", LAMP), ("bin", BIN)):
        (tmp_path / f"{name}.yaml").write_text(text)
    rclpy.init()
    try:
        operator = Operator(parameter_overrides=[Parameter("standalone", value=True)])
        with spin_in_thread(operator):
            for life in range(2):
                walker = make_walker(tmp_path)
                with spin_in_thread(walker):
                    operator.until(lambda node=walker: node.ready, "the node")
                    if life == 0:
                        operator.until(operator.control.service_is_ready, "its service")
                        assert operator.ask("break", "walk").success
                        continue
                    walker.go()
                    net = walker.exchange.nets["walker"]
                    operator.until(lambda found=net: found.proposed == ("walk",), "the token before the transition")
                    assert net.breakpoints == ("walk",)
    finally:
        rclpy.try_shutdown()


@pytest.mark.parametrize(("outcome", "success"), [("done", True), ("failed", False)])
def test_an_operator_says_what_became_of_an_action_in_doubt(machine, outcome, success):
    operator, walker = machine
    walker.hold = True
    outcomes = walker.go()
    operator.until(lambda: operator.markings["walker"].in_doubt == ["walk"], "the doubt")
    assert operator.tokens() == {"walk.in_doubt": 1}
    assert "known: walk" in operator.ask("resolve", "wlk=done").message
    assert operator.ask("resolve", f"walk={outcome}").success
    operator.until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success is success


@pytest.mark.parametrize(
    ("request_", "net", "reason"),
    [("stop", "walker", "there is no request to a net 'stop'"), ("pause", "wlker", "did you mean 'walker'")],
)
def test_what_makes_no_sense_is_refused_by_name(machine, request_, net, reason):
    answer = machine[0].ask(request_, net=net)
    assert not answer.success
    assert reason in answer.message


def test_a_net_is_replaced_when_it_comes_to_rest_and_else_it_is_said_what_keeps_it(machine):
    operator, walker = machine
    changed = WALKER.replace("go_done", "[go_done, walked]").replace("in: lost,", "in: lost, inhibitors: {idle: 1},")
    walker.hold = True
    outcomes = walker.go()
    operator.until(lambda: operator.markings["walker"].in_doubt, "the doubt")
    refusal = walker.load(changed)
    assert "its commands cannot go on in a former version: its transition give_up looks for the absence" in refusal
    assert "net walker is not at rest and stays as it is" in refusal
    assert "function walk of transition walk is in doubt" in refusal
    assert "command go (number 1) is open" in refusal
    threading.Timer(0.5, lambda: operator.ask("resolve", "walk=done")).start()
    assert walker.load(changed, patience_s=10.0) == ""
    operator.until(lambda: outcomes, "the end of the command")
    assert walker.exchange.nets["walker"].written.transitions["back"].emit == ("go_done", "walked")
    walker.hold = False
    assert walker.load(WALKER) == ""


def test_a_net_that_does_harm_only_together_with_another_is_refused_with_the_way_there(machine):
    operator, walker = machine
    refusal = walker.load(THROWER)
    assert "place bin.thrown.underway can grow without end" in refusal
    operator.until(lambda: operator.refusals, "the refusal")
    message = operator.refusals[0]
    assert (message.net, message.node) == ("thrower", "/walker")
    played = counterexample(message.json)
    assert {net["net"] for net in played["drawings"]} == {"thrower", "bin"}
    assert [step["fired"] for step in played["steps"]][:2] == ["", "thrower.throw"]


def test_a_net_takes_over_the_tokens_of_one_at_rest(machine):
    operator, walker = machine
    outcomes = walker.go("light")
    operator.until(lambda: outcomes, "the end of the command")
    assert walker.load(LAMP.replace("dim_done", "[dim_done, dimmed]")) == ""
    operator.until(lambda: operator.tokens("lamp") == {"bright": 1}, "the token")
    assert "bright=1: it has no such place" in walker.load(LAMP.replace("bright", "glaring"))
    outcomes = walker.go("dim")
    operator.until(lambda: outcomes, "the end of the command")
    assert outcomes[0].success


def test_a_choice_among_strategies_is_published_with_its_entropy_and_learned(machine):
    operator, walker = machine
    for symbol in ("light", "dim", "light", "dim"):
        outcomes = walker.go(symbol)
        operator.until(lambda ended=outcomes: ended, "the end of the command")
    operator.until(lambda: len(operator.choices) == 2, "the choices")
    first, second = operator.choices
    assert (first.net, sorted(first.alternatives)) == ("lamp", ["light", "shine"])
    assert list(first.probabilities) == pytest.approx([0.5, 0.5])
    assert first.entropy == pytest.approx(math.log(2.0))
    assert first.taken in first.alternatives
    favoured = dict(zip(second.alternatives, second.probabilities, strict=True))
    assert favoured[first.taken] > 0.5
    assert second.entropy < first.entropy
    assert second.command_entropy == pytest.approx(second.entropy)
    assert operator.ask("forget", "nothing", "lamp").message.startswith(
        "there is no strategy with experience 'nothing'"
    )
    assert operator.ask("forget", first.taken, "lamp").message == f"forgot lamp.{first.taken}"
    assert f"lamp.{first.taken}" not in read_experience(results_dir() / "strategies-walker.json")


def test_a_net_that_was_loaded_later_is_there_after_a_restart(tmp_path):
    for name, text in (("walker", WALKER), ("lamp", LAMP), ("bin", BIN)):
        (tmp_path / f"{name}.yaml").write_text(text)
    rclpy.init()
    try:
        changed = LAMP.replace("dim_done", "[dim_done, dimmed]")
        for life in range(2):
            walker = make_walker(tmp_path)
            with spin_in_thread(walker):
                deadline = clock.monotonic() + 60.0
                while not walker.ready and clock.monotonic() < deadline:
                    clock.sleep(0.02)
                assert walker.ready, walker.failed
                if life == 0:  # at rest once it has taken what its begin told it
                    while (refused := walker.load(changed)) and clock.monotonic() < deadline:
                        clock.sleep(0.02)
                    assert refused == ""
                assert walker.exchange.nets["lamp"].written.transitions["dim"].emit == ("dim_done", "dimmed")
    finally:
        rclpy.try_shutdown()


def test_files_of_nets_that_came_later_are_kept_as_far_as_somebody_may_need_them(machine, monkeypatch):
    monkeypatch.setattr("im_pnt_node.ros.library.MOST_KEPT", 3)
    _, walker = machine
    for number in range(6):
        changed = LAMP.replace("dim_done", f"[dim_done, dimmed_{number}]")
        assert walker.load(changed, patience_s=60.0) == ""
        if number == 0:
            assert walker.load(WALKER.replace("go_done", "[go_done, walked]"), patience_s=60.0) == ""
    (kept,) = {path.parent for path in (Path(net.written.source) for net in nets_of(walker)) if "nets" in path.parts}
    files = sorted(kept.glob("*.yaml"))
    assert len(files) == 5, "the newest three, and the others that run"
    assert {Path(net.written.source) for net in nets_of(walker) if net.net.name != "bin"} <= set(files)


def nets_of(walker):
    return list(walker.exchange.nets.values())
