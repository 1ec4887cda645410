"""Launch files, run against a recorder with the signatures that launch and launch_ros of Jazzy have.

The wheels have neither. The classes below were written beside ``launch/actions`` (``DeclareLaunchArgument``,
``ExecuteLocal``, ``ExecuteProcess``, ``OpaqueFunction``, ``Shutdown``), ``launch/substitutions`` and
``launch_ros/actions/node.py``: what those do not take, these do not take.
"""

import importlib.util
import os
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest
from ament_index_python.packages import get_package_share_directory

from im_bringup.machine import start

LAUNCH = Path(get_package_share_directory("im_bringup")) / "launch"
START = "/lib/im_bringup/start"


class Context:
    def __init__(self, **configurations):
        self.launch_configurations = configurations


class LaunchConfiguration:
    def __init__(self, variable_name, *, default=None):
        assert isinstance(variable_name, str)
        self.name, self.default = variable_name, default

    def perform(self, context):
        return context.launch_configurations[self.name]


def text(value):
    """A text, or substitutions and texts, as :func:`normalize_to_list_of_substitutions` takes them."""
    parts = value if isinstance(value, list | tuple) else [value]
    assert all(isinstance(part, str | LaunchConfiguration) for part in parts), value
    return value


class DeclareLaunchArgument:
    def __init__(self, name, *, default_value=None, description=None, choices=None):
        assert default_value is None or text(default_value) is not None
        assert isinstance(description, str)
        assert choices is None or default_value in choices
        self.name, self.default, self.description, self.choices = name, default_value, description, choices


class Shutdown:
    def __init__(self, *, reason="reason not given", condition=None):
        self.reason = reason


class ExecuteProcess:
    def __init__(
        self, *, cmd, prefix=None, name=None, cwd=None, env=None, additional_env=None, shell=False, sigterm_timeout="5",
        sigkill_timeout="5", emulate_tty=False, output="log", output_format="", cached_output=False, log_cmd=False,
        on_exit=None, respawn=False, respawn_delay=None, respawn_max_retries=-1, condition=None,
    ):  # fmt: skip
        self.cmd = [text(word) for word in cmd]
        assert all(float(text(seconds)) > 0 for seconds in (sigterm_timeout, sigkill_timeout))
        assert all(isinstance(word, str) for pair in (additional_env or {}).items() for word in pair)
        self.additional_env, self.on_exit, self.output = additional_env, on_exit, output
        self.patience_s = float(sigterm_timeout)


class Node(ExecuteProcess):
    def __init__(
        self, *, executable, package=None, name=None, namespace=None, exec_name=None, parameters=None, remappings=None,
        ros_arguments=None, arguments=None, **kwargs,
    ):  # fmt: skip
        super().__init__(cmd=[executable, *(arguments or ())], **kwargs)
        self.package, self.parameters = package, parameters


class OpaqueFunction:
    def __init__(self, *, function, args=None, kwargs=None):
        self.function = function


class LaunchDescription:
    def __init__(self, initial_entities=None):
        self.entities = list(initial_entities or ())


@pytest.fixture
def described(monkeypatch):
    """``described(name)``: arguments by name, and the other entities, of a launch file."""
    for name, classes in {
        "launch": (LaunchDescription, Context),
        "launch.actions": (DeclareLaunchArgument, ExecuteProcess, OpaqueFunction, Shutdown),
        "launch.substitutions": (LaunchConfiguration,),
        "launch_ros": (),
        "launch_ros.actions": (Node,),
    }.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, "LaunchContext" if each is Context else each.__name__, each)
        monkeypatch.setitem(sys.modules, name, module)

    def describe(name):
        spec = importlib.util.spec_from_file_location(name.replace(".", "_"), LAUNCH / name)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        entities = module.generate_launch_description().entities
        arguments = {each.name: each for each in entities if isinstance(each, DeclareLaunchArgument)}
        others = [each for each in entities if each not in arguments.values()]
        return SimpleNamespace(arguments=arguments, others=others)

    return describe


def process_of(described, name, **given):
    """The process that a launch file starts when it is given arguments."""
    file = described(name)
    assert given.keys() <= file.arguments.keys()
    for word, argument in file.arguments.items():
        value = given.setdefault(word, argument.default)
        assert argument.choices is None or value in argument.choices
    (function,) = file.others
    (process,) = function.function(Context(**given))
    assert (process.output, isinstance(process.on_exit, Shutdown)) == ("screen", True)
    return process


def test_each_option_of_start_is_an_argument_of_the_launch_file(described):
    arguments = described("machine.launch.py").arguments
    options = {
        action.dest: action for action in start.parser()._actions if action.dest not in ("help", "foreground", "host")
    }
    assert arguments.keys() == options.keys()
    for name, option in options.items():
        assert (arguments[name].choices == ["true", "false"]) == (option.nargs == 0)


def test_without_arguments_the_machine_is_the_default_deployment(described):
    process = process_of(described, "machine.launch.py")
    assert process.cmd[0].endswith(START)
    assert os.access(process.cmd[0], os.X_OK)
    assert process.cmd[1:] == ["--foreground"]
    assert process.patience_s > 5.0  # a machine may take as long to stop


def test_arguments_are_what_start_reads(described):
    given = {
        "factor": "0",
        "seed": "7",
        "port": "8081",
        "control": "true",
        "fresh": "true",
        "deployment": "my cell.yaml",
    }
    options = start.parser().parse_args(process_of(described, "machine.launch.py", **given).cmd[1:])
    assert (options.factor, options.seed, options.port, options.control) == (0.0, 7, 8081, True)
    assert (options.fresh, options.resume, options.unproved, options.foreground) == (True, False, None, True)
    assert options.deployment == "my cell.yaml"


def test_nets_run_alone(described, tmp_path):
    given = {"nets": "pick.yaml 'my cell.yaml'", "journal": "state", "page": "true", "use_sim_time": "true"}
    process = process_of(described, "nets.launch.py", **given)
    assert os.access(process.cmd[0], os.X_OK)
    assert process.cmd[0].endswith("/lib/im_pnt_node/pnt_node")
    assert process.cmd[1:] == [
        "pick.yaml", "my cell.yaml", "--journal=state", "--page", "--ros-args", "-p", "use_sim_time:=true",
    ]  # fmt: skip
    assert described("nets.launch.py").arguments["nets"].default is None  # it must be given


@pytest.mark.parametrize(("cell", "camera"), [("", "ceiling_left"), ("panda", "stand_a")])
def test_the_view_has_the_configuration_of_the_cell_and_the_time_of_the_machine(described, cell, camera):
    file = described("view.launch.py")
    (opaque,) = file.others
    (rviz,) = opaque.function(Context(cell=cell, config=""))
    assert (rviz.package, rviz.cmd[:2]) == ("rviz2", ["rviz2", "-d"])
    assert f"/{camera}/image_raw" in Path(rviz.cmd[2]).read_text()
    assert rviz.parameters == [{"use_sim_time": True}]
    assert isinstance(rviz.on_exit, Shutdown)
    (own,) = opaque.function(Context(cell=cell, config="my.rviz"))
    assert own.cmd[2] == "my.rviz"
