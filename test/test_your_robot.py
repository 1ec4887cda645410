"""``docs/tutorials/your_robot.md``: a task over two action servers of standard types, run, killed and resumed."""

import os
import re
import signal
import sys
from pathlib import Path

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from im_core import clock
from im_core.ros.node import ManagedNode
from im_pnt_analysis.cli import main as pnt

ROOT = Path(__file__).resolve().parent.parent
PAGE = (ROOT / "docs" / "tutorials/your_robot.md").read_text(encoding="utf-8")
FILES = ROOT / "docs" / "nets" / "your_robot"
FETCHED = ["gripper 0.04", "arm [0.4, -1.2, 0.8]", "gripper 0.01", "arm [0.0, -0.6, 0.6]"]
TYPED = re.findall(r"^\$ (.*)$", PAGE, re.MULTILINE)
TOY = re.findall(r"^\$ (.*)$", PAGE.partition("## First with a toy\n")[2].partition("\n## ")[0], re.MULTILINE)
LINES = [line.removeprefix("scripts/im pnt ") for line in TYPED if "my_robot/" in line.replace("your_robot/", "")]
VISIT = f"""
net: visit
include: {ROOT}/docs/nets/parts/steps.yaml
commands: {{visit: {{arguments: {{points: {{type: numbers, length: [1, 100]}}}}}}}}
places: {{idle: 1, wanted: , done: , failed: }}
transitions:
  begin: {{symbol: visit, in: idle, out: wanted}}
  go:
    with: {{for_each: {{count: "${{len(arguments.points)}}"}}}}
    in: wanted
    out: done
    says: go to ${{arguments.points[answers.for_each.index]}}
    await: {{name: /button, type: std_msgs/msg/Empty}}
    on_failure: failed
  tell: {{in: done, out: idle, emit: visit_done}}
  give_up: {{in: failed, out: idle, emit: visit_failed}}
"""


@pytest.fixture
def robot_process(process, tmp_path, wait_until):
    """The robot, whose servers are there."""
    child = process(sys.executable, ROOT / "test" / "support" / "robot.py", tmp_path)
    wait_until(lambda: "ready" in child.out.read_text(), "the robot")
    return child


@pytest.fixture
def robot(robot_process, tmp_path):
    """The folder in which the robot tells what it does."""
    return tmp_path


@pytest.fixture
def line(process, tmp_path):
    """``line(text)``: a line of the page as a process, with the folder of the test for the reader's own."""

    def start(text):
        words = text.replace("my_robot/", f"{FILES}/").replace(f"{FILES}/state", str(tmp_path / "state")).split()
        return process(sys.executable, "-m", "im_pnt_analysis", *words)

    return start


@pytest.fixture
def run_here(monkeypatch, capfd):
    """``run_here(words...)``: ``pnt run`` in this process; its exit code, and all that it says."""

    def run(*words):
        with monkeypatch.context() as patch:  # files beside a net are found once it is read
            patch.setattr(sys, "path", list(sys.path))
            code = pnt(["run", *map(str, words)])
        return code, "".join(capfd.readouterr())

    return run


def done(folder, file="done"):
    path = folder / file
    return path.read_text().splitlines() if path.exists() else []


PICK = """
net: pick
commands: {pick: {arguments: {width: {type: number, default: 0.02}}}}
places: {idle: {tokens: 1, resource: true}, open: , closed: , failed: }
transitions:
  open: {symbol: pick, in: idle, out: open}
  close: {in: open, out: closed, delay: 5.0}
  tell: {in: closed, out: idle, emit: pick_done, on_failure: failed, result: {closed_to: "${arguments.width}"}}
  give_up: {in: failed, out: idle, emit: pick_failed}
"""
WAIT = """
net: wait
places: {idle: 1, ready: , late: }
transitions:
  button: {symbol: begin, in: idle, out: ready, await: {name: /button, type: std_msgs/msg/Empty}, on_failure: late}
  end: {in: ready, out: idle, emit: begin_done}
  give_up: {in: late, out: idle, emit: begin_failed}
"""


def test_the_page_shows_the_files():
    pattern = r"\[`nets/your_robot/(\w+\.\w+)`\]\(\.\./nets/your_robot/\1\)\n```\w+\n(.*?)```"
    shown = dict(re.findall(pattern, PAGE, re.DOTALL))
    linked = {FILES / "toy_robot.py", *FILES.glob("*.test.yml")}
    assert shown == {file.name: file.read_text(encoding="utf-8") for file in {*FILES.glob("*.*")} - linked}


def test_the_toy_fetches_as_it_is_typed(process, wait_until):
    pack, toy, fetch = TOY
    packed = process("bash", "-c", pack)
    wait_until(lambda: packed.poll() is not None, "the end of the packing")
    assert (packed.returncode, 'pack done: {"parts": [2, 3], "mass": 3.8}' in packed.out.read_text()) == (0, True)
    robot = process("bash", "-c", toy)
    wait_until(lambda: "offers" in robot.out.read_text(), "the toy")
    fetched = process("bash", "-c", fetch)
    wait_until(lambda: fetched.poll() is not None, "the end of the task")
    assert (fetched.returncode, 'fetch done: {"width": 0.02}' in fetched.out.read_text()) == (0, True)
    told = [line.removeprefix("toy_robot: ") for line in robot.out.read_text().splitlines()]
    assert told[1:] == [
        "gripper at 0.040 m",
        "arm at [0.4, -1.2, 0.8] rad",
        "gripper at 0.020 m, holds the part",
        "arm at [0.0, -0.6, 0.6] rad",
    ]


def test_the_readme_begins_with_the_packing():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^scripts/.*", readme, re.MULTILINE)[1] == TOY[0]


@pytest.mark.parametrize("text", [text for text in LINES if text.split()[0] in ("verify", "simulate")])
def test_the_nets_of_the_page_are_verified_and_played(text, capsys):
    assert pnt(text.replace("my_robot/", f"{FILES}/").split()) == 0
    assert capsys.readouterr().out


def test_the_task_runs_to_its_end(robot, line, wait_until):
    command = line(next(text for text in LINES if "--symbol" in text and "--journal" not in text))
    wait_until(lambda: command.poll() is not None, "the end of the task")
    told = command.out.read_text()
    assert (command.returncode, done(robot)) == (0, FETCHED), told
    assert re.findall(r" s  (.*)$", told, re.MULTILINE) == [
        "open_gripper", "reach", "close_gripper", "lift", 'fetch done: {"width": 0.01}'
    ]  # fmt: skip


def test_a_task_that_is_killed_goes_on_where_it_was_and_does_nothing_twice(robot, line, wait_until):
    text = next(text for text in LINES if "--journal" in text)
    (robot / "hold").write_text("0.01")
    killed = line(text)
    wait_until(lambda: done(robot, "held"), "the gripper to begin to close")
    killed.kill()
    killed.wait()
    again = line(text)
    wait_until(lambda: "fetch goes on where the journal ends" in again.out.read_text(), "the second life")
    (robot / "hold").unlink()
    wait_until(lambda: again.poll() is not None, "the end of the task")
    assert (again.returncode, done(robot)) == (0, FETCHED), again.out.read_text()
    assert done(robot, "held") == ["gripper 0.01"]


def test_a_message_that_is_awaited_is_awaited_again_after_a_death(robot, line, wait_until):
    (robot / "wait.yaml").write_text(WAIT)
    text = f"run {robot}/wait.yaml --symbol begin --journal {robot}/journal"
    killed = line(text)
    wait_until(lambda: "s  button" in killed.out.read_text(), "the wait")
    killed.kill()
    killed.wait()
    again = line(text)
    wait_until(lambda: "begin goes on where the journal ends" in again.out.read_text(), "the second life")
    (robot / "pressed").touch()
    wait_until(lambda: again.poll() is not None, "the end")
    assert (again.returncode, "begin done" in again.out.read_text()) == (0, True), again.out.read_text()


def test_a_loop_needs_no_machine_and_outlives_its_process_and_that_of_its_data(robot, line, wait_until):
    (robot / "visit.yaml").write_text(VISIT)
    (robot / "pressed").touch()
    text = f"run {robot}/visit.yaml --symbol visit --arg points=[{'4.0,' * 50}7.0] --journal {robot}/state"
    killed = line(text)
    wait_until(lambda: killed.out.read_text().count("go to 4.0") > 2, "some of the points")
    killed.kill()
    killed.wait()
    again = line(text)
    wait_until(lambda: again.out.read_text().count("go to 4.0") > 2, "some more of the points")
    (keeper,) = Path(f"/proc/{again.pid}/task/{again.pid}/children").read_text().split()
    os.kill(int(keeper), signal.SIGKILL)
    wait_until(lambda: again.poll() is not None, "the end")
    told = [each.out.read_text() for each in (killed, again)]
    assert (again.returncode, told[1].count("this program does"), "visit done" in told[1]) == (0, 2, True), told[1]
    assert 50 <= sum(each.count("go to 4.0") for each in told) <= 52, "one that was under way is told again"
    assert sorted(each.name for each in (robot / "state").iterdir() if each.is_dir()) == [
        "commands",
        "ended",
        "journal",
    ]


def test_a_command_with_other_arguments_is_not_taken_for_the_one_that_goes_on(tmp_path, line, wait_until):
    (tmp_path / "pick.yaml").write_text(PICK)
    text = f"run {tmp_path}/pick.yaml --symbol pick --journal {tmp_path}/journal"
    killed = line(text)
    wait_until(lambda: "command 1: pick" in killed.out.read_text(), "the command to begin")
    clock.sleep(0.5)  # until it is on file
    killed.kill()
    killed.wait()
    again = line(f"{text} --arg width=0.07")
    wait_until(lambda: again.poll() is not None, "the end")
    told = again.out.read_text()
    assert again.returncode == 0, told
    assert [each for each in re.findall(r" s  (.*)$", told, re.MULTILINE) if "pick" in each] == [
        'pick of {"width": 0.02} goes on where the journal ends, and {"width": 0.07} comes after it',
        'pick done: {"closed_to": 0.07}',
    ]


@pytest.mark.parametrize(
    ("given", "code", "told"),
    [
        (["--arg", "limit=4.0"], 0, 'pack done: {"parts": [2, 3], "mass": 3.8}'),
        (["--arg", "masses=[3.5, 4.5]", "--arg", "limit=3.0"], 1, "pack failed: no part is as light as 3.0 kg"),
        (["--arg", "masses=[-1.0]"], 2, "argument masses[0] is -1.0, not a number >= 0 [kg]"),
    ],
)
def test_what_is_reckoned_in_python_comes_back_or_says_its_own_sentence(run_here, given, code, told):
    ended, said = run_here(FILES / "pack.yaml", "--symbol", "pack", *given)
    assert (ended, told in said) == (code, True), said


COUNT = """
net: count
places: {idle: 1, counted: , odd: }
transitions:
  count: {symbol: count, in: idle, out: counted, action: "MODULE:count", on_failure: odd}
  tell: {in: counted, out: idle, emit: count_done}
  give_up: {in: odd, out: idle, emit: count_failed}
"""


@pytest.mark.parametrize(
    ("module", "returned", "told"),
    [
        ("counting_a_key", "{1: 'one'}", "what count returned has the key 1"),
        ("counting_a_set", "{'parts': {2, 3}}", "what count returned.parts is {2, 3} (set)"),
        ("counting_no_number", "{'mass': float('nan')}", "what count returned.mass is nan"),
    ],
)
def test_results_that_nobody_could_be_told_fail_the_command_with_a_sentence(run_here, tmp_path, module, returned, told):
    (tmp_path / "count.yaml").write_text(COUNT.replace("MODULE", module))
    (tmp_path / f"{module}.py").write_text(f"def count(ctx):\n    ctx.result.update({returned})\n")
    ended, said = run_here(tmp_path / "count.yaml", "--symbol", "count")
    assert (ended, f"count failed: {told}" in said) == (1, True), said


def test_a_robot_that_is_not_there_is_said_to_be_missing(line, wait_until):
    alone, kept = (next(text for text in LINES if word in text) for word in ("fetch.yaml --symbol fetch", "--journal"))
    for typed in (alone, kept, kept):  # a journal of nothing under way is no mission that is waited for
        command = line(typed)
        wait_until(lambda command=command: command.poll() is not None, "the end of the task")
        told = command.out.read_text()
        assert command.returncode == 1
        assert "fetch failed: nobody offers the action /gripper_controller/gripper_cmd in ROS domain" in told


def test_a_robot_that_dies_ends_the_task_with_its_death_as_reason(robot_process, line, tmp_path, wait_until):
    (tmp_path / "hold").write_text("0.04")
    command = line(next(text for text in LINES if "--symbol" in text and "--journal" not in text))
    wait_until(lambda: done(tmp_path, "held"), "the gripper to begin to open")
    robot_process.kill()
    wait_until(lambda: command.poll() is not None, "the end of the task")
    told = command.out.read_text()
    assert command.returncode == 1
    assert "fetch failed: the result of /gripper_controller/gripper_cmd" in told
    assert "the node that owes it is gone" in told


STUCK = """
net: stuck
places: {idle: 1, asked: }
transitions:
  ask: {symbol: ask, in: idle, out: asked}
  hear: {in: asked, out: idle, guard: "answers:never", emit: ask_done}
"""


def test_a_command_without_a_way_out_does_not_keep_the_node(tmp_path, line, wait_until):
    """What a function of Python says is free in the proof: it may be wrong for good."""
    (tmp_path / "stuck.yaml").write_text(STUCK)
    (tmp_path / "answers.py").write_text("def never(ctx):\n    return False\n")
    child = line(f"run {tmp_path}/stuck.yaml --symbol ask")
    wait_until(lambda: "command 1: ask" in child.out.read_text(), "the command")
    child.send_signal(signal.SIGTERM)
    assert child.wait(60.0) == 1
    assert "ask: no way out of the marking stuck.asked; ends without it" in child.out.read_text()


INTERRUPTED = """
import sys
from im_pnt_node.ros import net_runner

obey = net_runner.RunNode._obey

async def interrupted(node, order):
    node.interrupt()
    await obey(node, order)

net_runner.RunNode._obey = interrupted
sys.exit(net_runner.main(sys.argv[1:]))
"""


def test_a_signal_that_comes_while_the_command_begins_cancels_the_command(tmp_path, process):
    (tmp_path / "stuck.yaml").write_text(STUCK)
    (tmp_path / "answers.py").write_text("def never(ctx):\n    return False\n")
    child = process(sys.executable, "-c", INTERRUPTED, tmp_path / "stuck.yaml", "--symbol", "ask")
    assert child.wait(120.0) == 1
    assert "cancels ask; once more ends at once" in child.out.read_text()


SAY = """
net: say
places: {idle: 1, said: , failed: }
escalate: failed
transitions:
  tell: {symbol: say, in: idle, out: said, topic: {name: /said, type: std_msgs/msg/String, message: {data: hello}}}
  end: {in: said, out: idle, emit: say_done}
  give_up: {in: failed, out: idle, emit: say_failed}
"""


def test_a_message_of_a_process_that_has_just_begun_is_heard(tmp_path, ros, line, wait_until):
    heard = []
    node = ros(ManagedNode("hearer"))
    node.create_subscription(String, "/said", lambda message: heard.append(message.data), 10)
    (tmp_path / "say.yaml").write_text(SAY)
    told = line(f"run {tmp_path}/say.yaml --symbol say")
    wait_until(lambda: told.poll() is not None, "the end of the command")
    assert told.returncode == 0
    wait_until(lambda: heard == ["hello"], "the message")


ASKS = """
net: asks
places: {idle: 1, failed: }
transitions:
  ask: {symbol: ask, in: idle, out: idle, service: {name: /lamp/on, type: std_srvs/srv/Trigger}, on_failure: failed,
        emit: ask_done}
  fail: {in: failed, out: idle, emit: ask_failed}
"""


@pytest.mark.parametrize(("new", "code", "told"), [
    ("/lamps/first/on", 0, "ask done"),
    ("/lamps/frist/on", 1, "nobody offers the service /lamps/frist/on"),
])  # fmt: skip
def test_a_service_is_sought_under_the_name_that_remapping_gives_it(tmp_path, ros, line, wait_until, new, code, told):
    node, asked = ros(ManagedNode("lamps")), []
    node.create_service(
        Trigger, "/lamps/first/on", lambda request, answer: asked.append(1) or Trigger.Response(success=True)
    )
    (tmp_path / "asks.yaml").write_text(ASKS)
    child = line(f"run {tmp_path}/asks.yaml --symbol ask --ros-args -r /lamp/on:={new}")
    wait_until(lambda: child.poll() is not None, "the end of the command")
    assert told in child.out.read_text()
    assert (child.returncode, len(asked)) == (code, 1 - code)
