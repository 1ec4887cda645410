"""Whatever a callback raises: it is said, counted on ``/diagnostics``, answered, and the node goes on."""

import ast
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest
from control_msgs.action import FollowJointTrajectory
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action.server import GoalResponse
from rclpy.parameter import Parameter
from rclpy.task import Future
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from im_core import clock
from im_core.errors import StateError
from im_core.ros import failures, guard, qos
from im_core.ros.calls import call_blocking, pause
from im_core.ros.failures import few
from im_core.ros.guard import GuardedActionClient, GuardedActionServer, GuardedNode
from im_core.ros.node import ManagedNode
from im_msgs.action import ExecuteCommand
from im_msgs.srv import GetObject
from support.loop import in_loop

pytestmark = pytest.mark.raises

ROOT = Path(__file__).resolve().parent.parent
FAULT = "what nobody thought of"
PERIODS_S = (0.05, 0.05, 0.06, 0.07, 0.25, 0.5, 2.0)


class Clumsy(ManagedNode):
    """A node every callback of which raises; what is right it answers."""

    def __init__(self):
        super().__init__("clumsy")
        self.heard, self.said = [], []
        self.create_subscription(String, "/clumsy/hear", self._hear, qos.EVENTS)
        self.create_service(Trigger, "/clumsy/at_once", self._at_once)
        self.create_service(SetBool, "/clumsy/later", self._later)
        self.create_service(Trigger, "/clumsy/who", lambda request, response: self._who)
        self.create_service(GetObject, "/clumsy/status", self._at_once)
        self.create_service(Trigger, "/clumsy/unsayable", self._unsayable)
        self.create_service(Trigger, "/clumsy/nothing", lambda request, response: None)
        self.create_timer(0.05, self._strike, clock=self.steady_clock)
        self.server = GuardedActionServer(
            self, ExecuteCommand, "/clumsy/do", self._do, goal_callback=self._accept, cancel_callback=self._strike
        )

    def _hear(self, message):
        self.heard.append(message.data)
        if message.data == "exit":
            sys.exit(FAULT)
        if not message.data.startswith("good"):
            raise ValueError(FAULT)

    def _at_once(self, request, response):
        raise KeyError(FAULT)

    async def _later(self, request, response):
        if request.data:
            response.success = True
            return response
        raise StateError(FAULT)

    def _who(self, client):
        sys.exit(FAULT)

    def _unsayable(self, request, response):
        response.success, response.message = True, "half a pair: \ud800"
        return response

    def _strike(self, *_):
        raise ZeroDivisionError(FAULT)

    def _accept(self, goal):
        if goal.symbol == "unacceptable":
            raise TypeError(FAULT)
        return GoalResponse.ACCEPT

    async def _do(self, handle):
        if handle.request.symbol == "unsayable":
            handle.succeed()
            return ExecuteCommand.Result(results="\ud800")
        raise AssertionError(FAULT)


@pytest.fixture
def clumsy(ros):
    return ros(Clumsy())


@pytest.fixture
def asker(ros):
    return ros(GuardedNode("asker"))


def test_subscriptions_and_timers_that_raise_are_counted_and_go_on(clumsy, asker, wait_until):
    told = []
    asker.create_subscription(DiagnosticArray, "/diagnostics", told.append, qos.EVENTS)
    publisher = asker.create_publisher(String, "/clumsy/hear", qos.EVENTS)
    wait_until(lambda: publisher.get_subscription_count(), "the subscription")
    for words in ("bad", "exit", "good"):
        publisher.publish(String(data=words))
    wait_until(lambda: clumsy.heard == ["bad", "exit", "good"], "all messages")
    assert clumsy.failures.counts["subscription /clumsy/hear"] == 2
    wait_until(lambda: clumsy.failures.counts.get("timer Clumsy._strike", 0) > 2, "the timer to go on")

    def counted():
        statuses = [status for message in told for status in message.status if status.name == "clumsy: callbacks"]
        return next(
            (s for s in statuses if ("subscription /clumsy/hear", "2") in {(v.key, v.value) for v in s.values}), None
        )

    status = wait_until(counted, "the count on /diagnostics")
    assert status.level == status.WARN
    assert FAULT in status.message


def test_who_floods_a_node_is_looked_for_in_the_graph_once_and_many_are_named_shortly(clumsy, monkeypatch):
    monkeypatch.setattr(failures, "clock", SimpleNamespace(monotonic=lambda: 100.0))
    asked = []

    def told():
        asked.append(True)
        return f"published by {few([f'/flood_{number}' for number in range(150)])}"

    noted = failures.Failures(clumsy)  # the node's own has what its timer raises, too
    for _ in range(100):
        noted.add("subscription /flood", ValueError(FAULT), told)
    assert noted.counts["subscription /flood"] == 100
    assert len(asked) == 1
    noted.add("subscription /other", ValueError(FAULT), told)
    names = "/flood_0, /flood_1, /flood_2, /flood_3, /flood_4 and 145 more"
    assert noted.last == f"subscription /other (published by {names}): ValueError: {FAULT}"


def test_the_log_names_topic_type_and_sender(clumsy, asker, wait_until):
    said = []
    clumsy.failures.add = lambda what, error, told: said.append((what, repr(error), told()))
    publisher = asker.create_publisher(String, "/clumsy/hear", qos.EVENTS)
    client = asker.create_client(Trigger, "/clumsy/at_once")
    wait_until(lambda: publisher.get_subscription_count(), "the subscription")
    publisher.publish(String(data="bad"))
    call_blocking(client, Trigger.Request(), 60.0, "an answer")
    heard = wait_until(lambda: next((e for e in said if e[0] == "subscription /clumsy/hear"), None), "the topic")
    assert heard[1:] == (repr(ValueError(FAULT)), "std_msgs/msg/String, published by /asker")
    called = next(e for e in said if e[0] == "service /clumsy/at_once")
    assert called[1] == repr(KeyError(FAULT))
    assert called[2].startswith("std_srvs/srv/Trigger, called by ")
    assert "/asker" in called[2]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("at_once", Trigger),
        ("later", SetBool),
        ("who", Trigger),
        ("unsayable", Trigger),
        ("nothing", Trigger),
        ("status", GetObject),
    ],
)
def test_a_service_that_raises_answers(clumsy, asker, name, kind):
    client = asker.create_client(kind, f"/clumsy/{name}")
    answer = call_blocking(client, kind.Request(), 60.0, "an answer")
    message = answer.message if hasattr(answer, "message") else answer.status.message
    assert not answer.success
    assert message.startswith(f"fault in service /clumsy/{name}: ")
    assert clumsy.failures.counts[f"service /clumsy/{name}"] == 1
    good = asker.create_client(SetBool, "/clumsy/later")
    assert call_blocking(good, SetBool.Request(data=True), 60.0, "an answer").success


def test_requests_that_are_refused_are_counted(ros, asker, wait_until):
    node = GuardedNode("picky")
    node.create_service(SetBool, "/picky/only_true", lambda request, _: SetBool.Response(success=request.data))
    ros(node)
    client = asker.create_client(SetBool, "/picky/only_true")
    assert client.wait_for_service(60.0)
    for refused, data in ((0, True), (1, False), (2, False)):
        answer = client.call_async(SetBool.Request(data=data))
        wait_until(answer.done, "the answer")
        assert node.refused == refused


def test_goals_whose_callbacks_raise_are_rejected_or_aborted(clumsy, asker, wait_until):
    client = GuardedActionClient(asker, ExecuteCommand, "/clumsy/do")
    assert client.wait_for_server(60.0)

    def outcome(symbol):
        sent = client.send_goal_async(ExecuteCommand.Goal(symbol=symbol))
        handle = wait_until(lambda: sent.done() and sent.result(), f"the server to take {symbol}")
        if not handle.accepted:
            return None
        result = handle.get_result_async()
        return wait_until(lambda: result.done() and result.result(), f"the result of {symbol}")

    assert outcome("unacceptable") is None
    failed = outcome("any")
    assert not failed.result.success
    assert failed.result.status.code == "internal"
    assert FAULT in failed.result.status.message
    unsayable = outcome("unsayable")
    assert "surrogates" in unsayable.result.status.message
    kept = clumsy.server._goal_handles.values()
    assert [handle.request for handle in kept] == [None, None]  # what was asked does not add up


def test_a_result_whose_answer_was_lost_is_asked_for_again(ros, asker, monkeypatch, wait_until):
    """As where the asking process was stopped for longer than the lease of discovery: the server takes it for gone."""
    ended = threading.Event()

    async def work(goal):
        while not ended.is_set():
            await pause(server, 0.01)
        goal.succeed()
        return ExecuteCommand.Result(success=True)

    server = ros(ManagedNode("diligent"))
    actions = GuardedActionServer(server, ExecuteCommand, "/diligent/do", work)
    lost = []
    answer = actions._send_result_response
    monkeypatch.setattr(actions, "_send_result_response", lambda *told: answer(*told) if lost else lost.append(told))
    monkeypatch.setattr(guard, "RESULT_AGAIN_S", 0.2)
    client = GuardedActionClient(asker, ExecuteCommand, "/diligent/do")
    assert client.wait_for_server(60.0)
    sent = client.send_goal_async(ExecuteCommand.Goal())
    result = wait_until(lambda: sent.done() and sent.result(), "the server to take a goal").get_result_async()
    ended.set()
    assert wait_until(lambda: result.done() and result.result(), "the result").result.success
    assert len(lost) == 1
    client.destroy()


def test_a_trajectory_whose_callback_raises_has_not_succeeded():
    result = guard.with_fault(FollowJointTrajectory.Result(), "action /left/follow_joint_trajectory", ValueError(FAULT))
    assert result.error_code == FollowJointTrajectory.Result.INVALID_GOAL
    assert result.error_string == f"fault in action /left/follow_joint_trajectory: ValueError: {FAULT}"


class Untold:
    """Events of an action that cannot be published."""

    def tell_goal(self, request):
        raise RuntimeError(FAULT)

    def tell_result(self, handle, result):
        raise RuntimeError(FAULT)


def test_a_goal_that_cannot_be_told_is_carried_out_all_the_same(ros, asker, monkeypatch, wait_until):
    """Its events are for who listens; what happens does not hang on them."""

    def work(goal):
        goal.succeed()
        return ExecuteCommand.Result(success=True)

    server = ros(ManagedNode("teller"))
    actions = GuardedActionServer(server, ExecuteCommand, "/teller/do", work)
    monkeypatch.setattr(actions, "_events", Untold())
    client = GuardedActionClient(asker, ExecuteCommand, "/teller/do")
    assert client.wait_for_server(60.0)
    sent = client.send_goal_async(ExecuteCommand.Goal())
    result = wait_until(lambda: sent.done() and sent.result(), "the server to take a goal").get_result_async()
    assert wait_until(lambda: result.done() and result.result(), "the result").result.success
    assert server.failures.counts == {"action /teller/do (its event)": 2}
    client.destroy()


def test_a_goal_that_ends_after_its_server_was_destroyed_says_nothing(ros, asker, wait_until):
    """As at the end of a node; a client that asked for the result has no server that could answer."""
    server, over = ros(ManagedNode("leaving")), Future()

    async def work(goal):
        await over
        goal.succeed()
        return ExecuteCommand.Result(success=True)

    actions = GuardedActionServer(server, ExecuteCommand, "/leaving/do", work)
    client = GuardedActionClient(asker, ExecuteCommand, "/leaving/do")
    assert client.wait_for_server(60.0)
    sent = client.send_goal_async(ExecuteCommand.Goal())
    handle = wait_until(lambda: sent.done() and sent.result(), "the server to take a goal")
    handle.get_result_async()
    (result,) = actions._result_futures.values()
    wait_until(lambda: result._callbacks, "the client to ask for the result")
    in_loop(server, actions.destroy)
    in_loop(server, result.set_result, ExecuteCommand.Impl.GetResultService.Response())
    in_loop(server, lambda: None)  # behind the answer
    assert server.failures.counts == {}
    client.destroy()


def test_a_service_that_was_destroyed_answers_nobody_and_is_no_failure(ros, asker, wait_until):
    server, over, begun = ros(ManagedNode("leaving")), [], []

    async def work(request, response):
        over.append(server.promise())
        await over[0]
        begun.append(request)
        return response

    service = server.create_service(Trigger, "/leaving/ask", work)
    client = asker.create_client(Trigger, "/leaving/ask")
    assert client.wait_for_service(60.0)
    client.call_async(Trigger.Request())
    wait_until(lambda: over, "the request")
    in_loop(server, server.destroy_service, service)
    in_loop(server, over[0].set_result, None)
    wait_until(lambda: begun, "the answer")
    in_loop(server, lambda: None)
    assert server.failures.counts == {}


def test_what_a_node_waited_for_may_come_after_its_end(asker, recwarn):
    """As the end of a thread: rclpy would warn of an unhandled exception in a callback."""
    node = ManagedNode("ended", parameter_overrides=[Parameter("standalone", value=True)])
    future, promise = Future(), node.promise()
    future.add_done_callback(lambda _: promise.set_result(None))
    node.destroy_node()
    future.set_result(None)
    assert [str(told.message) for told in recwarn if "done callback" in str(told.message)] == []


def test_coroutines_alarms_and_tasks_that_raise_leave_the_loop_turning(clumsy, wait_until):
    async def work():
        raise OSError(FAULT)

    def strike():
        raise LookupError(FAULT)

    rung = []
    for _ in range(2):
        clumsy.spawn(work())
        clumsy.executor.create_task(work())
        clumsy.alarms.after(0.0, strike)
    clumsy.alarms.after(0.0, lambda: rung.append(True))
    counts = clumsy.failures.counts
    wait_until(lambda: rung, "the alarm after those that raised")
    wait_until(lambda: counts.get("coroutine") == 2, "the coroutines")
    wait_until(lambda: counts.get("the executor") == 2, "the tasks")
    assert counts["timer Alarms._strike"] == 2


def test_every_node_of_the_product_is_guarded():
    """Nobody derives from the node, action server or action client of rclpy, makes one, or spins, but the guard."""
    raw = {"Node", "LifecycleNode", "ActionServer", "ActionClient"}
    allowed = {"guard.py"}
    wrong = []
    for path in sorted(ROOT.glob("ros_ws/src/*/*/**/*.py")):
        if {"test", "im"} & set(path.relative_to(ROOT).parts) or path.name in allowed:
            continue
        text = path.read_text(encoding="utf-8")
        if "rclpy" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ClassDef):
                bases = {ast.unparse(base).rpartition(".")[2] for base in node.bases}
                wrong += [f"{path.name}: {node.name}({base})" for base in bases & raw]
            elif isinstance(node, ast.Call):
                called = ast.unparse(node.func)
                if called.rpartition(".")[2] in raw - {"Node"} | {"create_node"} or called in ("Node", "rclpy.spin"):
                    wrong.append(f"{path.name}:{node.lineno}: {called}()")
    assert wrong == []


def test_no_thread_beside_the_executor_gives_a_goal_through_a_bare_client():
    """One of rclpy drops an answer that comes before the asking thread has noted what it asked, and hangs then."""
    bare = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for folder in ("bench", "test")
        for path in sorted(ROOT.glob(f"{folder}/**/*.py"))
        if path.name not in ("attack.py", "stranger.py")  # which ask within the loop
        and "ActionClient" in (text := path.read_text(encoding="utf-8"))
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] == "ActionClient"
    ]
    assert bare == []


def test_every_publisher_names_a_profile():
    """A bare number hides how late a reader may be: ten messages of /clock are a tenth of a second."""
    bare = []
    for path in sorted(ROOT.glob("ros_ws/src/*/im_*/**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(".create_publisher"):
                given = [*node.args, *(keyword.value for keyword in node.keywords)]
                if any(isinstance(each, ast.Constant) and isinstance(each.value, int) for each in given):
                    bare.append(f"{path.name}:{node.lineno}")
    assert bare == []


def test_a_node_takes_no_name_that_its_base_uses_itself():
    """Seen: ``_told`` of a node that executes nets, as that of a service, ended each turn of its nets."""
    with pytest.raises(TypeError, match=r"Server\._set_phase: ManagedNode uses this name itself; take another one"):
        type("Server", (ManagedNode,), {"_set_phase": lambda self: None})
    with pytest.raises(TypeError, match=r"Server\._apply_descriptors: "):  # of rclpy
        type("Server", (GuardedNode,), {"_apply_descriptors": lambda self: None})
    type("Server", (ManagedNode,), {"_serve": lambda self: None, "phase_start": lambda self: None})


def test_a_module_run_by_its_name_is_of_its_package():
    """Seen: a client run by ``python -m`` was refused, as if its client were of another package."""
    shown = subprocess.run(
        [sys.executable, "-m", "im_bringup.ros.run_command", "--help"], capture_output=True, text=True, timeout=60
    )
    assert (shown.returncode, shown.stderr) == (0, "")


def test_timers_that_are_reset_while_the_loop_is_late_put_no_other_off(ros, wait_until):
    node, woken = ManagedNode("late"), []
    slow = [node.create_timer(period_s, lambda: clock.sleep(0.004), clock=node.steady_clock) for period_s in PERIODS_S]
    other = node.create_timer(0.001, lambda: (woken.append(None), other.cancel()), clock=node.steady_clock)
    ros(node)
    wait_until(lambda: woken, "the first turn of the loop")
    woken.clear()

    def be_late():
        clock.sleep(0.7)
        for _ in range(300):  # each has the timers looked at once more
            other.reset()

    node.executor.create_task(be_late)
    wait_until(lambda: woken, "the other timer")
    later = []
    clock.sleep(1.0)
    node.executor.create_task(lambda: later.append(None))
    wait_until(lambda: later, "a turn of the loop")  # which is not busy with strikes that are too many
    wait_until(lambda: all(timer.time_until_next_call() <= timer.timer_period_ns for timer in slow), "timers in time")


def test_a_timer_that_is_destroyed_while_its_strike_waits_is_not_called(ros):
    """As by another thread that ends the node; here nobody else turns the loop, which has taken the strike already."""
    struck = []
    node = ManagedNode("late")
    timer = node.create_timer(10.0, lambda: struck.append(None), clock=node.steady_clock)
    strike = timer.callback
    strike()
    timer.destroy()
    strike()
    assert len(struck) == 1
    node.destroy_node()
