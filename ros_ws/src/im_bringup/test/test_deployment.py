import os
import re
import subprocess
import sys

import pytest
import yaml

from im_bringup.machine import start
from im_bringup.tasks import agent, deployment
from im_cell.robot import cell_file
from im_core.config import package_file, parse_model
from im_core.errors import ConfigError, DataError, NotFoundError

TASK = "{package: im_dom, executable: %s, node: /%s, parameters: %s}"


def machine(hosts):
    """A deployment from ``{host: {process: {task: parameters}}}``, as YAML text."""
    lines = ["seed: 3", "hosts:"]
    for host, processes in hosts.items():
        lines.append(f"  {host}: {'' if processes else '{}'}")
        for process, tasks in processes.items():
            lines.append(f"    {process}: {'' if tasks else '{}'}")
            lines += [f"      {name}: {TASK % (name, name, parameters)}" for name, parameters in tasks.items()]
    return "\n".join(lines)


def parsed(text):
    return parse_model(text, deployment.Deployment, name="d.yaml")


def test_the_default_deployment_holds_the_nodes_of_the_architecture():
    nodes = {placed.task.node for placed in deployment.load(deployment.default_path()).tasks()}
    assert nodes == {
        "/dispatcher",
        "/motion_coordinator",
        "/gripper_coordinator",
        "/vision_coordinator",
        "/path_planning_coordinator",
        "/dom",
        "/mcs",
        "/vss",
        "/testbed",
        "/pnt_display",
    }


def test_ids_are_unique_and_count_in_starting_order():
    placed = list(parsed(machine({"localhost": {"a": {"one": "{}"}}, "far": {"b": {"two": "{}"}}})).tasks())
    assert [(task.id, task.name, task.host, task.process) for task in placed] == [
        (1, "one", "localhost", "a"),
        (2, "two", "far", "b"),
    ]


def test_moving_a_task_is_moving_its_line():
    here = parsed(machine({"localhost": {"a": {"one": "{}"}, "b": {"two": "{}"}}}))
    there = parsed(machine({"localhost": {"a": {"one": "{}"}}, "far": {"b": {"two": "{}"}}}))
    assert tasks_of(here.on_host("localhost")) == {"a": ["one"], "b": ["two"]}
    assert tasks_of(there.on_host("far")) == {"b": ["two"]}
    with pytest.raises(NotFoundError, match="no host of the deployment 'fat'; did you mean 'far'"):
        there.on_host("fat")


@pytest.mark.parametrize("name", ["default", "each", "two_hosts", "three_hosts"])
def test_each_task_of_a_shipped_file_moves_to_each_process_and_keeps_what_it_is(name):
    """Only what shares memory stays on one host, and so do all tasks of a process that has it."""
    text = deployment.default_path().with_name(f"{name}.yaml").read_text()
    shipped = parsed(text)
    moved = refused = 0
    for task in shipped.tasks():
        for host, process in [(host, process) for host, each in shipped.hosts.items() for process in each]:
            content = yaml.safe_load(text)
            line = content["hosts"][task.host][task.process].pop(task.name)
            content["hosts"][host][process][task.name] = line
            content["hosts"] = {  # headings that have nothing left go with it
                at: {name: tasks for name, tasks in each.items() if tasks} for at, each in content["hosts"].items()
            }
            content["hosts"] = {at: each for at, each in content["hosts"].items() if each}
            if task.name in SIMULATED and host != "localhost":
                with pytest.raises(ConfigError, match=r"shares? .*memory|is on host"):
                    parsed(yaml.safe_dump(content, sort_keys=False))
                refused += 1
                continue
            there = {each.name: each for each in parsed(yaml.safe_dump(content, sort_keys=False)).tasks()}
            assert there[task.name].task == task.task
            assert (there[task.name].host, there[task.name].process) == (host, process)
            moved += 1
    others = [process for host, each in shipped.hosts.items() if host != "localhost" for process in each]
    assert refused == len(SIMULATED) * len(others)
    assert moved == sum(1 for _ in shipped.tasks()) * sum(map(len, shipped.hosts.values())) - refused


def tasks_of(processes):
    return {process: [placed.name for placed in tasks] for process, tasks in processes.items()}


def test_a_process_may_have_several_tasks():
    value = parsed(machine({"localhost": {"a": {"one": "{}", "two": "{}"}, "b": {"three": "{}"}}}))
    assert tasks_of(value.on_host("localhost")) == {"a": ["one", "two"], "b": ["three"]}
    assert [placed.id for placed in value.tasks()] == [1, 2, 3]


def test_each_has_the_tasks_of_the_default_deployment_each_in_a_process_of_its_own():
    path = deployment.default_path()
    together, each = deployment.load(path), deployment.load(path.with_name("each.yaml"))
    assert [(placed.name, placed.task) for placed in each.tasks()] == [
        (placed.name, placed.task) for placed in together.tasks()
    ]
    assert all(len(tasks) == 1 for tasks in each.on_host("localhost").values())
    assert each.model_copy(update={"hosts": {}}) == together.model_copy(update={"hosts": {}})
    assert tasks_of(together.on_host("localhost"))["coordination"] == [
        "dom",
        "motion_coordinator",
        "gripper_coordinator",
        "vision_coordinator",
        "path_planning_coordinator",
        "dispatcher",
        "pnt_display",
    ]


@pytest.mark.parametrize(
    ("name", "hosts"),
    [
        ("two_hosts", {"localhost": ["testbed", "mcs", "vss"], "coordination": ["coordination"]}),
        (
            "three_hosts",
            {"localhost": ["testbed", "mcs", "vss"], "coordination": ["coordination"], "display": ["pnt_display"]},
        ),
    ],
)
def test_the_deployments_over_hosts_have_the_tasks_and_values_of_the_default_one(name, hosts):
    path = deployment.default_path()
    default, spread = deployment.load(path), deployment.load(path.with_name(f"{name}.yaml"))
    assert [(placed.name, placed.task) for placed in spread.tasks()] == [
        (placed.name, placed.task) for placed in default.tasks()
    ]
    assert spread.model_copy(update={"hosts": {}}) == default.model_copy(update={"hosts": {}})
    assert {host: list(spread.on_host(host)) for host in spread.hosts} == hosts


SIMULATED = {
    "testbed": "{package: im_sim, executable: testbed, node: /testbed}",
    "mcs": "{package: im_mcs, executable: mcs, node: /mcs}",
    "vss": "{package: im_vss, executable: vss, node: /vss}",
}


def spread(far, task):
    """A deployment as YAML text: the testbed with all but one of those that share memory with it, which is far."""
    here = "\n".join(f"    {name}: {{{name}: {text}}}" for name, text in SIMULATED.items() if name != far)
    return f"hosts:\n  localhost:\n{here}\n  far:\n    {far}:\n      {far}: {task}\n"


@pytest.mark.parametrize("far", ["mcs", "vss"])
def test_what_shares_memory_with_the_testbed_is_refused_on_another_host(far):
    told = (
        rf"d\.yaml:7: hosts\.far\.{far}\.{far}: task '{far}' is on host 'far' and the testbed on 'localhost': .*memory"
    )
    with pytest.raises(ConfigError, match=told):
        parsed(spread(far, SIMULATED[far]))


@pytest.mark.parametrize(("far", "own"), [("mcs", "config"), ("vss", "settings")])
def test_with_a_configuration_of_other_hardware_it_may_be_on_any_host(far, own):
    task = SIMULATED[far].replace("}", f", parameters: {{{own}: /etc/other.yaml}}}}")
    assert list(parsed(spread(far, task)).on_host("far")) == [far]


def test_a_port_for_foxglove_adds_the_bridge_to_the_first_host():
    plain = parsed(machine({"far": {"a": {"one": "{}"}}, "localhost": {"b": {"two": "{}"}}}))
    assert [placed.name for placed in plain.tasks()] == ["one", "two"]
    bridged = plain.with_values(foxglove=9000)
    bridge = list(bridged.tasks())[-1]
    assert (bridge.id, bridge.name, bridge.host, bridge.process) == (3, "foxglove_bridge", "far", "foxglove_bridge")
    assert (bridge.task.package, bridge.task.node) == ("im_bag", "/foxglove_bridge")
    assert bridged.parameters_of(bridge.task)["port"] == 9000
    assert tasks_of(bridged.on_host("far")) == {"a": ["one"], "foxglove_bridge": ["foxglove_bridge"]}
    assert tasks_of(bridged.on_host("localhost")) == {"b": ["two"]}
    assert deployment.with_options_text(plain, deployment.options_text(bridged)) == bridged


def test_references_become_values_and_keep_their_type():
    text = machine({"localhost": {"a": {"one": '{factor: "${clock_factor}", seed: "${seed}", name: "run ${seed}"}'}}})
    changed = parsed(text).with_values(clock_factor=0.0)
    (placed,) = changed.tasks()
    given = {"factor": 0.0, "seed": 3, "name": "run 3"}
    assert changed.parameters_of(placed.task) == {"use_sim_time": True, "introspection": "contents", **given}


def test_references_in_lists_become_values_too():
    text = machine({"localhost": {"a": {"one": '{seeds: ["${seed}", 5], names: ["run ${seed}", "$5"]}'}}})
    value = parsed(text)
    (placed,) = value.tasks()
    given = value.parameters_of(placed.task)
    assert (given["seeds"], given["names"]) == ([3, 5], ["run 3", "$5"])


def test_a_task_may_refuse_simulated_time_and_telling_what_it_carries():
    value = parsed(machine({"localhost": {"a": {"one": "{use_sim_time: false, introspection: metadata}"}}}))
    assert value.parameters_of(next(value.tasks()).task) == {"use_sim_time": False, "introspection": "metadata"}


@pytest.mark.parametrize(
    ("hosts", "sentence"),
    [
        (
            {"localhost": {"a": {"one": "{}"}, "b": {"one": "{}"}}},
            "task 'one' is in process 'a' of host 'localhost' and",
        ),
        (
            {"localhost": {f"p{n}": {f"t{n}": "{}"} for n in range(101)}},
            "the deployment has 101 tasks; at most 100 are allowed",
        ),
        ({"localhost": {"a" * 65: {"one": "{}"}}}, "String should have at most 64 characters"),
        ({"localhost": {"a": {}}}, "process 'a' of host 'localhost' has no task"),
        (
            {"localhost": {"a": {"one": '{x: "${sed}"}'}}},
            "'${sed}'; known are calibration, clock_factor, commands, control, perfect_arm, period, port, seed",
        ),
        ({"localhost": {"a": {"one": '{x: ["${seed}", "${nix}"]}'}}}, "parameter 'x' of task 'one' refers to '${nix}'"),
        ({"localhost": {"a": {"one": '{x: "${ period }"}'}}}, "refers to '${ period }'; known are"),
        ({"localhost": {"a": {"one": '{x: "${clock-factor}"}'}}}, "refers to '${clock-factor}'; known are"),
        ({"localhost": {"a": {"one": '{x: "run ${seed"}'}}}, "refers to '${seed'; known are"),
        ({"localhost": {"a": {"one": '{x: "${}"}'}}}, "refers to '${}'; known are"),
        (
            {"localhost": {"verification": {"one": "{}"}}},
            "process 'verification' of host 'localhost': this name is reserved",
        ),
        ({"localhost": {"bootstrap": {"one": "{}"}}}, "process 'bootstrap' of host 'localhost': this name is reserved"),
        ({"localhost": {"a": {"bootstrap": "{}"}}}, "task 'bootstrap' has the node /bootstrap, which is the machine's"),
        ({"localhost": {"a": {"one": "{}"}}, "far": {}}, "d.yaml:6: hosts.far: host 'far' has no process"),
        ({"far": {"a": {"agent_far": "{}"}}}, "task 'agent_far' has the node /agent_far, which is the agent of host"),
        (
            {"far-1": {"a": {"one": "{}"}}, "far.1": {"b": {"two": "{}"}}},
            "d.yaml:7: hosts.far.1: node /agent_far_1 is the agent of host 'far-1', and that of host 'far.1'",
        ),
        ({"localhost": {"a": {"one": "{x: [1, two]}"}}}, "parameter 'x' of task 'one' is a list of int and str; ROS"),
        ({"localhost": {"a": {"one": "{x: {y: 1}}"}}}, "d.yaml:5: hosts.localhost.a.one.parameters.x: a parameter is"),
    ],
)
def test_contradictions_are_refused(hosts, sentence):
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        parsed(machine(hosts))


def test_errors_name_file_line_and_field():
    text = machine({"localhost": {"a": {"one": "{}"}}}).replace("executable: one", "executable: Dom!")
    with pytest.raises(ConfigError, match=r"^d\.yaml:5: hosts\.localhost\.a\.one\.executable: 'Dom!'"):
        parsed(text)


@pytest.mark.parametrize(
    ("hosts", "told"),
    [
        (
            {"a": {"one": "{}"}, "b": {"two": "{}", "one": "{}"}},
            r"d\.yaml:8: hosts\.localhost\.b\.one: task 'one' is in",
        ),
        ({"a": {"one": "{}"}, "b": {}}, r"d\.yaml:6: hosts\.localhost\.b: process 'b' of host 'localhost' has no task"),
        ({"a": {"one": "{}", "two": '{x: "${nix}"}'}}, r"d\.yaml:6: hosts\.localhost\.a\.two: parameter 'x' of task"),
    ],
)
def test_what_contradicts_another_part_of_the_file_is_told_with_its_line(hosts, told):
    with pytest.raises(ConfigError, match=f"^{told}"):
        parsed(machine({"localhost": hosts}))


def test_a_node_must_be_named_as_its_task():
    text = machine({"localhost": {"a": {"one": "{}"}}}).replace("node: /one", "node: /other")
    with pytest.raises(ConfigError, match="task 'one' has the node /other, which must be /one"):
        parsed(text)


def test_two_tasks_of_a_process_are_of_two_executables():
    """A name for the node of one executable is one for every node of it in the process."""
    text = machine({"localhost": {"a": {"one": "{}", "two": "{}"}}}).replace("executable: two", "executable: one")
    with pytest.raises(ConfigError, match=r"^d\.yaml:5: hosts\.localhost\.a: tasks 'one' and 'two' of one process run"):
        parsed(text)


@pytest.mark.parametrize("cell", ["ur6", "./nix.yaml"])
def test_a_cell_that_is_not_there_is_told_with_the_line_that_names_it(tmp_path, cell):
    path = tmp_path / "d.yaml"
    path.write_text(f"cell: {cell}\n{machine({'localhost': {'a': {'one': '{}'}}})}")
    with pytest.raises(ConfigError, match=r"d\.yaml:1: cell: .*(did you mean 'ur5'|there is no such file)"):
        deployment.load(path)


def test_values_out_of_range_are_refused():
    value = parsed(machine({"localhost": {"a": {"one": "{}"}}}))
    with pytest.raises(ConfigError, match="clock_factor: -1"):
        value.with_values(clock_factor=-1.0)


def test_commands_are_names_and_files_relative_to_the_deployment(tmp_path):
    path = tmp_path / "d.yaml"
    parameters = '{commands: "${commands}"}'
    path.write_text("commands: [move, nets/, ../mine.yaml]\n" + machine({"localhost": {"a": {"one": parameters}}}))
    loaded = deployment.load(path)
    (placed,) = loaded.tasks()
    files = [str(tmp_path / "nets"), str(tmp_path.parent / "mine.yaml")]
    assert loaded.parameters_of(placed.task)["commands"] == ",".join(["move", *files])


def test_a_comma_in_a_command_or_in_the_folder_of_its_file_is_refused_in_words(tmp_path):
    path = tmp_path / "a,b" / "d.yaml"
    path.parent.mkdir()
    path.write_text("commands:\n  - move\n  - nets/\n" + machine({"localhost": {"a": {"one": "{}"}}}))
    with pytest.raises(ConfigError, match=r"d\.yaml:3: commands\[1\]: .*/a,b/nets: a comma is not allowed in the name"):
        deployment.load(path)
    path.write_text(path.read_text().replace("nets/", "open,close"))
    with pytest.raises(
        ConfigError, match=r"d\.yaml:3: commands\[1\]: 'open,close': a comma is not allowed in the name"
    ):
        deployment.load(path)


def test_every_command_that_is_shipped_is_in_the_default_deployment():
    assert list(deployment.load(deployment.default_path()).commands) == ["shipped"]


def test_what_a_start_was_given_reaches_other_hosts_as_it_is():
    parameters = '{seed: "${seed}", f: "${clock_factor}"}'
    text = machine({"localhost": {"a": {"one": "{}"}}, "far": {"b": {"two": parameters}}})
    given = parsed(text).with_values(clock_factor=0.5, seed=11, port=9090, period=0.002, control=True, unproved=True)
    told = deployment.with_options_text(parsed(text), deployment.options_text(given))
    assert told == given
    (two,) = told.on_host("far")["b"]
    assert told.parameters_of(two.task)["seed"] == 11
    assert told.parameters_of(two.task)["f"] == 0.5


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("{", DataError, "the options of the start"),
        ("[1]", DataError, "the options of the start"),
        ('{"seed": 3}', DataError, "the options of the start are {\"seed\": 3}; needed are "),
        (deployment.options_text(parsed(machine({"localhost": {"a": {"one": "{}"}}}))).replace("3", "-3"), ConfigError,
         "seed: -3"),
    ],
)  # fmt: skip
def test_what_is_told_of_a_start_and_is_none_is_refused(text, error, message):
    with pytest.raises(error, match=message):
        deployment.with_options_text(parsed(machine({"localhost": {"a": {"one": "{}"}}})), text)


def test_the_cell_is_named_once_for_all_tasks(tmp_path):
    folder = cell_file("puma_pair").parent
    shipped = (folder / "cell.yaml").read_text(encoding="utf-8").replace("puma_pair.urdf", f"{folder}/puma_pair.urdf")
    (tmp_path / "my_cell.yaml").write_text(shipped.replace("period: 0.0045", "period: 0.005", 1), encoding="utf-8")
    text = package_file("im_bringup", "deployments/default.yaml").read_text(encoding="utf-8")
    (tmp_path / "machine.yaml").write_text(text.replace('cell: ""', "cell: my_cell.yaml"), encoding="utf-8")
    read = deployment.load(tmp_path / "machine.yaml")
    assert read.cell == str(tmp_path / "my_cell.yaml")
    environment = agent.environment({}, tmp_path, read)
    code = "from im_cell.robot import load_cell; print(load_cell().period)"
    command = [sys.executable, "-c", code]
    told = subprocess.run(command, env={**os.environ, **environment}, capture_output=True, text=True, check=True)
    assert told.stdout == "0.005\n"
    assert "IM_CELL" not in agent.environment({}, tmp_path, deployment.load(deployment.default_path()))


def test_a_wrong_cell_is_refused_before_anything_starts(tmp_path):
    (tmp_path / "my_cell.yaml").write_text("period: 0.0045\n", encoding="utf-8")
    one = parsed(machine({"localhost": {"a": {"vss": "{}"}}}))
    with pytest.raises(ConfigError, match=r"my_cell.yaml:1: urdf: Field required"):
        start.check_cell(one.with_values(cell=str(tmp_path / "my_cell.yaml")), None)
    two = parsed(machine({"near": {"a": {"vss": "{}"}}, "far": {"b": {"mcs": "{}"}}}))
    with pytest.raises(ConfigError, match="--cell is for one host"):
        start.check_cell(two, "/a/cell.yaml")


def test_a_folder_of_calibrations_of_this_host_is_not_for_a_task_of_another():
    reads = {"vss": '{calibration: "${calibration}"}'}
    deployment.require_calibration_here(parsed(machine({"localhost": {"a": reads}})), "/kept")
    there = parsed(machine({"localhost": {"b": {"one": "{}"}}, "far": {"a": reads}}))
    deployment.require_calibration_here(there, None)
    in_list = {"vss": '{folders: ["${calibration}"]}'}
    assert parsed(machine({"far": {"a": in_list}})).hosts["far"]["a"]["vss"].takes("calibration")
    with pytest.raises(ConfigError, match=r"--calibration /kept is a folder of this host, .* 'vss'.*on host 'far'"):
        deployment.require_calibration_here(there, "/kept")
