"""``im topic``, ``service``, ``action``, ``node``, ``lifecycle``, ``param``: the verbs of ros2cli, on any nodes."""

import contextlib
import re
import subprocess
import sys
import threading

import pytest
import yaml
from control_msgs.action import GripperCommand
from lifecycle_msgs.msg import State, Transition, TransitionDescription
from lifecycle_msgs.srv import ChangeState, GetAvailableTransitions, GetState
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.action import ActionServer, CancelResponse
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, String
from std_srvs.srv import SetBool

from im_bringup.ros.graph import action, client, lifecycle, node, parameter, service, topic
from im_core import clock
from im_core.names import run_dir
from im_core.ros.run import Spinner
from support.whole_machine import ROOT

COMMANDS = {"topic": topic, "service": service, "action": action, "node": node, "lifecycle": lifecycle}
COMMANDS["param"] = parameter
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Oven(Node):
    """A node of each kind of interface: not one of ours."""

    def __init__(self):
        super().__init__("oven")
        self.heard, self.cancelled = [], threading.Event()
        self.create_publisher(String, "/oven/recipe", LATCHED).publish(String(data="x" * 300))
        states = self.create_publisher(JointState, "/oven/joints", QoSProfile(depth=5, reliability=BEST_EFFORT))
        self.create_timer(0.02, lambda: states.publish(JointState(name=["door"], position=[0.5])))
        self.create_subscription(Float64, "/oven/heat", lambda message: self.heard.append(message.data), 10)
        self.create_service(SetBool, "/oven/light", self._light)
        self.declare_parameter("degrees", 180.0, ParameterDescriptor(description="of the bars"))
        self.declare_parameter("names", ["upper", "lower"])
        self.add_on_set_parameters_callback(self._check)
        self.state = State(id=State.PRIMARY_STATE_INACTIVE, label="inactive")
        self.create_service(GetState, "/oven/get_state", self._get_state)
        self.create_service(ChangeState, "/oven/change_state", self._change)
        self.create_service(GetAvailableTransitions, "/oven/get_available_transitions", self._transitions)
        self.server = ActionServer(
            self, GripperCommand, "/oven/door", self._move, cancel_callback=lambda _: CancelResponse.ACCEPT
        )

    def _light(self, request, response):
        response.success, response.message = request.data, "it is lit" if request.data else "it is dark"
        return response

    def _check(self, parameters):
        hot = any(each.name == "degrees" and each.value > 300 for each in parameters)
        return SetParametersResult(successful=not hot, reason="it would burn" if hot else "")

    def _get_state(self, _, response):
        response.current_state = self.state
        return response

    def _change(self, request, response):
        response.success = request.transition.id == Transition.TRANSITION_ACTIVATE
        if response.success:
            self.state = State(id=State.PRIMARY_STATE_ACTIVE, label="active")
        return response

    def _transitions(self, _, response):
        for number, label in ((Transition.TRANSITION_ACTIVATE, "activate"), (Transition.TRANSITION_CLEANUP, "cleanup")):
            told = TransitionDescription(transition=Transition(id=number, label=label))
            response.available_transitions.append(told)
        return response

    async def _move(self, goal):
        wanted = goal.request.command.position
        goal.publish_feedback(GripperCommand.Feedback(position=0.25))
        while wanted > 1.0 and not goal.is_cancel_requested:
            await self._later()
        if goal.is_cancel_requested:
            self.cancelled.set()
            goal.canceled()
        elif wanted < 0.0:
            goal.abort()
        else:
            goal.succeed()
        return GripperCommand.Result(position=wanted, reached_goal=wanted >= 0.0)

    async def _later(self):
        later = Future()
        timer = self.create_timer(0.02, lambda: later.done() or later.set_result(None))
        await later
        self.destroy_timer(timer)


@pytest.fixture
def oven(ros):
    return ros(Oven())


@pytest.fixture
def im(oven, monkeypatch, capfd):
    """``im("topic", "list")``: exit code, output and errors; ROS is already there, and the client in this process."""
    clients, printed = [], []

    def kept(*texts, **options):
        printed.append(" ".join(map(str, texts)))
        print(*texts, **options)

    for module in (topic, action):
        monkeypatch.setattr(module, "print", kept, raising=False)

    @contextlib.contextmanager
    def spun(make):
        clients.append(make())
        with Spinner([clients[-1]]):
            yield clients[-1]

    monkeypatch.setattr(client, "spun", spun)

    def run(kind, *texts):
        code = COMMANDS[kind].parser().run([str(text) for text in texts])
        said = capfd.readouterr()
        return code, said.out, said.err

    run.clients, run.printed = clients, printed
    return run


def interrupted_after(im, text, times=1):
    """Interrupt the client, as Ctrl-C does, once it has printed a text so many times."""

    def interrupt():
        while sum(text in line for line in list(im.printed)) < times:
            clock.sleep(0.01)
        im.clients[-1].interrupt()

    threading.Thread(target=interrupt, daemon=True).start()


def test_topics_are_listed_with_types_and_kept_for_the_shell(im):
    code, out, _ = im("topic", "list", "-t")
    assert code == 0
    assert {"/oven/heat [std_msgs/msg/Float64]", "/oven/joints [sensor_msgs/msg/JointState]"} <= set(out.splitlines())
    assert "/_" not in out, "hidden ones of actions"
    assert "/oven/heat" in (run_dir() / "topics.txt").read_text().split()


def test_of_a_topic_its_type_and_its_ends_are_told(im):
    assert im("topic", "type", "oven/heat")[:2] == (0, "std_msgs/msg/Float64\n")
    code, out, _ = im("topic", "info", "/oven/joints", "-v")
    assert (code, out.splitlines()[0]) == (0, "Type: sensor_msgs/msg/JointState")
    assert "Publisher count: 1\n  /oven: BEST_EFFORT, VOLATILE\n" in out


def test_a_message_is_printed_as_yaml_and_long_ones_are_cut(im):
    code, out, _ = im("topic", "echo", "/oven/joints", "--once")
    assert (code, out.endswith("---\n")) == (0, True)
    told = yaml.safe_load(out.removesuffix("---\n"))
    assert (told["name"], told["position"], told["header"]["frame_id"]) == (["door"], [0.5], "")
    assert yaml.safe_load(im("topic", "echo", "/oven/recipe", "--once")[1][:-4])["data"] == "x" * 128 + "..."
    assert yaml.safe_load(im("topic", "echo", "/oven/recipe", "--once", "-f")[1][:-4])["data"] == "x" * 300


def test_an_echo_ends_with_an_interruption(im):
    interrupted_after(im, "---", times=6)
    code, out, _ = im("topic", "echo", "/oven/joints")
    assert code == 130
    assert out.count("---\n") >= 6


def test_what_is_not_there_is_said_with_the_time_that_was_waited(im):
    code, out, err = im("topic", "echo", "/oven/joint", "--once", "--timeout", 1)
    assert (code, out) == (3, "")
    assert "im topic: there is no topic '/oven/joint' (waited 1 s); did you mean '/oven/joints'" in err
    code, _, err = im("topic", "echo", "/oven/heat", "--once", "--timeout", 1)
    assert (code, err) == (3, "im topic: waited 1 s for a message on /oven/heat, in vain\n")


def test_the_rate_of_a_topic_is_told(im):
    interrupted_after(im, "average rate: ")
    code, _, _ = im("topic", "hz", "/oven/joints")
    assert code == 130


def test_messages_from_before_count_for_no_rate(im, oven):
    """They come all at once, and would make it a hundred times as large."""
    latched = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    bell = oven.create_publisher(String, "/oven/bell", latched)
    for _ in range(100):
        bell.publish(String())
    code, out, err = im("topic", "hz", "/oven/bell", "--timeout", 1)
    assert (code, out, err) == (3, "", "im topic: waited 1 s for a message on /oven/bell, in vain\n")


def test_the_rate_is_that_of_the_intervals():
    told = topic.rate_text([0.0, 0.1, 0.3])
    assert told == "average rate: 6.667\n\tmin: 0.100s max: 0.200s std dev: 0.05000s window: 3"


def test_a_message_is_published_once_a_subscription_is_there(im, oven, wait_until):
    code, out, _ = im("topic", "pub", "--once", "/oven/heat", "std_msgs/msg/Float64", "{data: 3}")
    assert (code, out) == (0, "publishing #1: {data: 3}\n")
    wait_until(lambda: oven.heard == [3.0], "the message")
    code, _, err = im("topic", "pub", "-1", "--timeout", "1", "/oven/nobody", "std_msgs/msg/Float64")
    assert (code, err) == (3, "im topic: waited 1 s for 1 subscription of /oven/nobody, in vain\n")


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ("{date: 1}", "no field of std_msgs/msg/Float64 'date'; did you mean 'data'"),
        ("{data: warm}", "std_msgs/msg/Float64.data (double) cannot be 'warm'"),
        ("3", "std_msgs/msg/Float64 cannot be 3: the fields of a message are needed"),
        ("{data", "the values: not YAML: did not find expected"),
    ],
)
def test_values_that_do_not_fit_are_bad_usage(im, values, sentence):
    code, _, err = im("topic", "pub", "--once", "/oven/heat", "std_msgs/msg/Float64", values)
    assert code == 2
    assert sentence in err


def test_a_service_is_called_and_its_answer_is_yaml(im):
    assert "/oven/light [std_srvs/srv/SetBool]" in im("service", "list", "-t")[1].splitlines()
    assert im("service", "type", "/oven/light")[1] == "std_srvs/srv/SetBool\n"
    code, out, _ = im("service", "call", "/oven/light", "std_srvs/srv/SetBool", "{data: true}")
    assert (code, yaml.safe_load(out)) == (0, {"success": True, "message": "it is lit"})


def test_a_service_of_another_type_is_not_waited_for(im):
    code, _, err = im("service", "call", "/oven/light", "std_srvs/srv/Trigger")
    assert code == 2
    assert err == "im service: the service /oven/light is of type std_srvs/srv/SetBool, not std_srvs/srv/Trigger\n"
    code, _, err = im("service", "call", "/oven/light", "std_srvs/srv/Triger")
    assert code == 2
    assert "no srv type of std_srvs 'Triger'; did you mean 'Trigger'" in err


GOAL = ("/oven/door", "control_msgs/action/GripperCommand")


def test_a_goal_is_sent_and_its_result_is_yaml(im):
    assert "/oven/door [control_msgs/action/GripperCommand]" in im("action", "list", "-t")[1].splitlines()
    assert "Action servers: 1\n    /oven\n" in im("action", "info", "/oven/door")[1]
    code, out, _ = im("action", "send_goal", "-f", *GOAL, "{command: {position: 0.5}}")
    assert code == 0
    assert "Feedback:\nposition: 0.25\n" in out
    assert "Result:\nposition: 0.5\n" in out
    assert out.endswith("Goal finished with status: SUCCEEDED\n")


def test_a_goal_that_fails_is_a_failure(im):
    code, out, _ = im("action", "send_goal", *GOAL, "{command: {position: -1}}")
    assert (code, out.splitlines()[-1]) == (1, "Goal finished with status: ABORTED")


def test_an_interruption_cancels_the_goal(im, oven):
    interrupted_after(im, "Goal accepted")
    code, out, _ = im("action", "send_goal", *GOAL, "{command: {position: 5}}")
    assert (code, out.splitlines()[-1]) == (1, "Goal finished with status: CANCELED")
    assert oven.cancelled.is_set()


KILN = """
import rclpy
from control_msgs.action import GripperCommand
from rclpy.action import ActionServer
rclpy.init()
node = rclpy.create_node("kiln")
def bake(goal):
    print("baking", flush=True)
    input()
server = ActionServer(node, GripperCommand, "/kiln/door", bake)
rclpy.spin(node)
"""


def test_the_end_of_a_goal_is_not_awaited_from_a_server_that_was_killed(im):
    with subprocess.Popen(
        [sys.executable, "-c", KILN], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as kiln:
        threading.Thread(target=lambda: kiln.stdout.readline() and kiln.kill(), daemon=True).start()
        code, _, err = im("action", "send_goal", "/kiln/door", GOAL[1], "--timeout", "60")
    assert (code, err) == (1, "im action: the server of /kiln/door is gone; the end of the goal is unknown\n")


def test_nodes_are_listed_with_what_they_offer(im):
    assert im("node", "list")[:2] == (0, "/oven\n"), "its own node is hidden"
    code, out, _ = im("node", "info", "/oven")
    assert code == 0
    assert "  Subscribers:\n    /oven/heat: std_msgs/msg/Float64\n" in out
    assert "  Action Servers:\n    /oven/door: control_msgs/action/GripperCommand\n" in out
    for words in ("node info /stove", "lifecycle get /stove", "param set /stove degrees 1"):
        code, _, err = im(*words.split(), "--timeout", "1")
        assert code == 3
        assert f"im {words.split()[0]}: there is no node '/stove' (waited 1 s)" in err


def test_states_of_lifecycle_nodes_are_told_and_changed(im):
    assert im("lifecycle", "nodes")[:2] == (0, "/oven\n")
    assert im("lifecycle", "get")[:2] == (0, "/oven: inactive [2]\n")
    assert im("lifecycle", "list", "/oven")[1] == "- activate [3]\n- cleanup [2]\n"
    assert im("lifecycle", "set", "/oven", "activate")[:2] == (0, "Transitioning successful\n")
    assert im("lifecycle", "get", "oven")[1] == "active [3]\n"
    code, _, err = im("lifecycle", "set", "/oven", "boil")
    assert (code, err) == (2, "im lifecycle: /oven has no transition boil now; it has activate, cleanup\n")
    assert im("lifecycle", "set", "/oven", "cleanup")[0] == 1


def test_parameters_are_listed_got_and_set(im):
    assert {"degrees", "names"} <= set(im("param", "list", "/oven")[1].split())
    assert "/oven:\n" in im("param", "list")[1]
    assert im("param", "get", "/oven", "degrees")[1] == "Double value is: 180.0\n"
    assert im("param", "get", "/oven", "names")[1] == "String values are: ['upper', 'lower']\n"
    assert im("param", "set", "/oven", "degrees", "200.0")[:2] == (0, "Set parameter successful\n")
    assert im("param", "get", "/oven", "degrees", "--hide-type")[1] == "200.0\n"
    code, _, err = im("param", "set", "/oven", "degrees", "400.0")
    assert (code, err) == (1, "im param: setting degrees of /oven failed: it would burn\n")
    code, _, err = im("param", "get", "/oven", "degree")
    assert code == 3
    assert "no parameter of /oven 'degree'; did you mean 'degrees'" in err


def completed(*words):
    """What a shell completes after some words of a line that begins with ``im``."""
    line = " ".join(f"'{word}'" for word in ("im", *words))
    program = f"source scripts/im_completion.bash; COMP_WORDS=({line}); COMP_CWORD={len(words)}; _im; "
    program += 'printf "%s\\n" "${COMPREPLY[@]}"'
    environment = {"IM_RUN_DIR": str(run_dir()), "PATH": "/usr/bin:/bin"}
    done = subprocess.run(
        ["bash", "-c", program], cwd=ROOT, env=environment, capture_output=True, text=True, check=True
    )
    return done.stdout.split()


def test_a_shell_completes_the_subcommands_that_there_are():
    script = (ROOT / "scripts" / "im").read_text()
    assert sorted(completed("")) == sorted(re.findall(r"^  \[(\w+)\]=", script, re.MULTILINE))


@pytest.mark.parametrize("kind", COMMANDS)
def test_a_shell_completes_the_verbs_that_there_are(kind):
    verbs = COMMANDS[kind].parser()._verbs.choices
    assert completed(kind[:-1]) == [kind]
    assert completed(kind, "") == sorted(verbs)


@pytest.mark.parametrize("subcommand", ["cell", "dom", "pnt", "security", "vss"])
def test_a_shell_completes_the_verbs_of_other_subcommands(subcommand):
    refused = subprocess.run([ROOT / "scripts" / "im", subcommand, "nonsense"], capture_output=True, text=True)
    verbs = re.findall(r"'(\w+)'", refused.stderr.rpartition("choose from")[2])
    assert verbs
    assert completed(subcommand, "") == sorted(verbs)


def test_a_shell_completes_the_names_that_were_listed_last(im):
    im("topic", "list")
    im("node", "list")
    assert completed("topic", "echo", "/oven/j") == ["/oven/joints"]
    assert completed("param", "get", "") == ["/oven"]
