"""The commands of the Dispatcher: a module and a net each."""

import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from im_cell.robot import load_cell
from im_core.clock import thread_cpu
from im_core.config import package_file
from im_core.errors import ConfigError, ImError
from im_core.names import CELL
from im_dispatcher import commands
from im_dispatcher.cell.needs import Needs, resources_of
from im_dispatcher.cell.net import cell_net
from im_dispatcher.command import joined
from im_dispatcher.report import StepTimes
from im_pnt.errors import MissingPartsError, NetError
from im_pnt.execution.functions import Functions
from im_pnt.model.action import FunctionAction, GoalAction, RequestAction, ServiceAction, TopicAction
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net
from im_pnt_analysis import verify_to_load
from im_pnt_analysis.composition.resource_proof import unheld
from support.process import Process

NET = """
net: wave
places: {idle: 1, waved: }
transitions:
  wave: {symbol: wave, in: [idle], out: [waved], action: wave, on_failure: [waved]}
  done: {in: [waved], out: [idle], emit: wave_done}
"""
MODULE = """
from pathlib import Path

from im_dispatcher.command import CommandDescription
from im_pnt.execution.functions import Functions
from im_pnt.model.action import RequestAction

COMMAND = CommandDescription(
    net=Path(__file__).parent.parent / "nets/wave.yaml",
    functions=lambda host, _: Functions({"wave": lambda ctx: host.warn("waving")}),
)
"""

COORDINATORS = package_file("im_coordinators", "nets/motion_coordinator.yaml").parent


class Host:
    """Of a node, only its log."""

    def __init__(self) -> None:
        self.log: list[str] = []

    def warn(self, text: str) -> None:
        self.log.append(text)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose modules are commands, too."""
    for name in ("commands", "nets"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(commands, "__path__", [*commands.__path__, str(tmp_path / "commands")])
    yield tmp_path
    for name in ("wave", "broken"):
        sys.modules.pop(f"{commands.__name__}.{name}", None)


def test_every_net_that_is_shipped_can_be_loaded_and_names_functions_that_there_are() -> None:
    host = Host()
    functions = joined(command.functions(host, StepTimes()) for command in commands.installed())
    nets = [load_net(file) for file in commands.net_files(commands.shipped())]
    for net in nets:
        functions.check(net)
    described = {command.net.resolve() for command in commands.installed()}
    assert described <= {Path(net.source).resolve() for net in nets}


def test_every_command_that_is_shipped_says_what_it_takes_and_needs_what_the_cell_has() -> None:
    nets = [load_net(file) for file in commands.net_files(commands.shipped())]
    needs = Needs(nets, resources_of(load_cell()))
    for net in nets:
        assert set(net.commands) == set(net.symbols())
        assert all(symbol in needs and declared.description for symbol, declared in net.commands.items())


GRIPPING = {"close_gripper", "open_gripper", "pick", "place", "hand_over", "handover", "gripper_coordinator"}


@pytest.mark.parametrize(
    ("cell", "lacking"),
    [
        ("puma_pair", set()),
        ("ur5", {"check_camera", "demo", "find", "look_laser", *GRIPPING}),
        ("ur_pair", {"check_camera", "find", "look_laser", *GRIPPING}),
        ("panda", {"check_camera", "demo", "find", "hand_over", "handover", "look_laser"}),
        ("so101", {"check_camera", "demo", "find", "look_laser", *GRIPPING}),
    ],
)
def test_the_nets_that_are_shipped_fit_every_cell_that_has_their_parts(
    cell: str, lacking: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CELL, cell)
    there, out = [], {}
    for file in (*commands.net_files(commands.shipped()), *sorted(COORDINATORS.glob("*.yaml"))):
        try:
            there.append(load_net(file))
        except MissingPartsError as error:
            out[file.stem] = error.message
    assert out.keys() == lacking
    assert all("of the cell, which has" in why for why in out.values())
    assert {"home", "move", "motion_coordinator", "path_planning_coordinator"} <= {net.name for net in there}
    needs = Needs([net for net in there if net.commands], resources_of(load_cell()))
    groups = [variant.choice["group"] for variant in needs.variants.values() if variant.symbol == "home"]
    assert groups == list(load_cell().groups)
    forms = [declared.arguments.json_schema() for net in there for declared in net.commands.values()]
    fields = [(name, one["enum"]) for form in forms for name, one in form["properties"].items() if "enum" in one]
    offered = {"group": list(load_cell().groups), "camera": list(load_cell().cameras)}
    assert {name for name, _ in fields} >= offered.keys(), "fields of the page's forms"
    assert all(enum == offered[name] for name, enum in fields if name in offered)


def test_without_poses_in_the_cell_file_a_camera_on_an_arm_is_not_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = package_file("im_cell", "cells/puma_pair/cell.yaml")
    cell = yaml.safe_load(shipped.read_text())
    cell["urdf"], cell["poses"] = (str(shipped.parent / cell[name]) for name in ("urdf", "poses"))
    del cell["cameras"]["wrist_left"]["check"]
    (tmp_path / "cell.yaml").write_text(yaml.safe_dump(cell))
    monkeypatch.setenv(CELL, str(tmp_path / "cell.yaml"))
    out = {}
    for file in commands.net_files(commands.shipped()):
        try:
            load_net(file)
        except MissingPartsError as error:
            out[file.stem] = error.message
    assert out.keys() == {"check_camera", "handover"}
    assert all("it needs 1 of the checking_arms of the cell, which has 0" in why for why in out.values())


def test_all_that_is_shipped_is_verified_together_in_few_markings() -> None:
    """The Dispatcher's nets, that of the cell, and those of the Coordinators: composed they have 10 to the 10."""
    nets = [load_net(file) for file in commands.net_files(commands.shipped())]
    cell = cell_net(Needs(nets, resources_of(load_cell())))
    coordinators = package_file("im_coordinators", "nets/motion_coordinator.yaml").parent.glob("*.yaml")
    report = verify_to_load([cell, *nets, *map(load_net, sorted(coordinators))])
    report.require_ok()
    assert report.states < 1_500_000


@pytest.mark.parametrize(
    ("command", "need", "sentence"),
    [
        (
            "move",
            '"${arguments.group}_arm"',
            "go of net move acts on left_arm, right_arm, which command move does not hold",
        ),
        ("look", '"${arguments.camera}", ', "find_spot of net look acts on ceiling_left, ceiling_right, table, wall"),
        ("demo", ', "$(arms[1])_arm"', "second.turn of net demo acts on right_arm, which command demo does not hold"),
        ("close_gripper", '"${arguments.group}_gripper", ', "close of net close_gripper acts on left_gripper, which"),
        (
            "calibrate_camera",
            ", $(cameras)",
            "find_spot of net calibrate_camera acts on ceiling_left, ceiling_right, ta",
        ),
    ],
)
def test_a_shipped_command_that_needs_less_than_it_acts_on_is_refused(command: str, need: str, sentence: str) -> None:
    file = commands.NETS / f"{command}.yaml"
    text = file.read_text()
    before, needs, after = text.partition("needs:")
    net = parse_net(before + needs + after.replace(need, "", 1), f"{command}.yaml", file)
    coordinators = package_file("im_coordinators", "nets/motion_coordinator.yaml").parent.glob("*.yaml")
    cases = unheld([net, *map(load_net, sorted(coordinators))], thread_cpu() + 60.0)
    assert any(f"{command}.yaml:" in case.reason and sentence in case.reason and case.sequence for case in cases or ())


DIRECT = [
    (file.stem, name)
    for file in sorted(COORDINATORS.glob("*.yaml"))
    for name, transition in load_net(file).transitions.items()
    if isinstance(transition.action, ServiceAction | GoalAction | TopicAction)
]
OF_NO_SERVICE = {"find_pos", "do_calibrate", "calibrate_again"}
"""They ask, and reckon: nobody needs to hold anything for it."""


@pytest.mark.parametrize(("net", "name"), DIRECT)
def test_what_a_coordinator_does_is_what_its_service_says_that_it_acts_on(net: str, name: str) -> None:
    """Whoever asks for the service holds that; with less of it, or without a word of the action, the net is refused."""
    written = load_net(COORDINATORS / f"{net}.yaml")
    transition = written.transitions[name]

    def reasons(changed: Net) -> list[str]:
        return [case.reason for case in unheld([changed], thread_cpu() + 60.0) or ()]

    assert reasons(written) == []
    silent = {**written.transitions, name: replace(transition, acts_on=None)}
    (reason,) = reasons(replace(written, transitions=silent))
    assert f"transition {name} of net {net} does not say what its {transition.action} acts on" in reason
    assert (transition.acts_on == ()) == (name in OF_NO_SERVICE)
    for thing in transition.acts_on or ():
        less = {
            each.name: replace(each, acts_on=tuple(other for other in each.acts_on or () if other != thing))
            for each in written.services.values()
        }
        lacking = reasons(replace(written, services=less))
        assert any(f"transition {name} of net {net}" in each for each in lacking)


def test_beside_commands_that_hold_things_one_that_needs_nothing_says_that_it_moves_nothing() -> None:
    text = NET.replace("action: wave", "service: {name: /mcs/stop, type: std_srvs/srv/Trigger}")
    with pytest.raises(NetError, match=r"wave.yaml:5: transition wave of net wave does not say what its service"):
        Needs([parse_net(text, "wave.yaml")], ())
    assert "wave" not in Needs([parse_net(text.replace("out: [waved]", "out: [waved], acts_on: []", 1))], ())


def test_commands_are_named_by_name_file_or_folder(folder: Path) -> None:
    for name in ("b", "a"):
        (folder / f"nets/{name}.yaml").write_text(NET)
    files = commands.net_files(["move", str(folder / "nets"), str(folder / "nets/b.yaml")])
    assert [file.name for file in files] == ["move.yaml", "a.yaml", "b.yaml"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mve", "did you mean 'move'"),
        ("nets", r"there is no command that is shipped 'nets' .*; a folder of net files is meant by \./nets$"),
        ("./nothing.yaml", "nothing.yaml: there is no such net file"),
        ("/proc/self/fd", "there is no net file"),
        ("", "no command is named: give net files, folders of them, shipped, or names of calibrate_camera, "),
    ],
)
def test_a_command_that_there_is_not_is_named(name: str, message: str) -> None:
    with pytest.raises(ImError, match=message):
        commands.net_files([name])


def test_a_command_is_added_by_a_module_and_a_net(folder: Path) -> None:
    (folder / "commands/wave.py").write_text(MODULE)
    (folder / "nets/wave.yaml").write_text(NET)
    (wave,) = [command for command in commands.installed() if command.net.name == "wave.yaml"]
    net, host = load_net(wave.net), Host()
    functions = wave.functions(host, StepTimes())
    functions.check(net)
    assert net.symbols() == ("wave",)
    functions.actions["wave"](None)
    assert host.log == ["waving"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no attribute 'COMMAND'"),
        ("COMMAND = 7", "broken:COMMAND is no CommandDescription"),
        ("import nothing_such", "No module named 'nothing_such'"),
    ],
    ids=["nothing", "something else", "broken"],
)
def test_a_module_that_describes_no_command_is_named(folder: Path, text: str, message: str) -> None:
    (folder / "commands/broken.py").write_text(text)
    with pytest.raises(ConfigError, match=message):
        commands.installed()


def test_functions_of_several_commands_are_joined_unless_two_have_the_same_name() -> None:
    def wave(_: object) -> None:
        pass

    whole = joined([Functions({"wave": wave}), Functions({"nod": wave}, {"tired": bool})])
    assert list(whole.actions) == ["wave", "nod"]
    assert set(whole.guards) == {"cancelled", "tired"}
    with pytest.raises(ConfigError, match="two commands of the Dispatcher have a function 'wave'"):
        joined([Functions({"wave": wave}), Functions({"wave": print})])


ESTABLISH = {"power_up", "light_on"}
#: What needs neither: it may fail for good.
WITHOUT = {"light_on", "light_off", "power_down", "calibrate", "keep_observation"}
PATHS = ["calibrate_camera", "move", "home", "look", "demo", "open_gripper", "close_gripper"]


@pytest.mark.parametrize("name", PATHS)
def test_what_fails_as_power_or_light_went_with_a_life_of_the_machine_can_establish_them_again(name: str) -> None:
    """From where a request that needs them fails, a way leads over a branch for that to where they are asked for."""
    net = load_net(package_file("im_dispatcher", f"nets/{name}.yaml"))
    asked = {
        each.name: each.action.service for each in net.transitions.values() if isinstance(each.action, RequestAction)
    }
    entries = {
        place for each, service in asked.items() if service in ESTABLISH for place in net.transitions[each].inputs
    }
    assert entries
    for begins, service in asked.items():
        if service in WITHOUT:
            continue
        reached, guards = set(net.transitions[begins].on_failure), []
        for _ in net.transitions:
            for each in net.transitions.values():
                if each.name not in asked and reached & set(each.inputs):
                    guards.append(each.guard)
                    reached |= set(each.outputs)
        assert entries & reached, f"{name}: {begins} fails for good when the machine has begun anew"
        assert any(guard and "begun_anew" in guard.name and not guard.negated for guard in guards)


@pytest.mark.parametrize(("joints", "position"), [(0, 0), (9, 3), (2, 0), (0, 2), (2, 3), (9, 1)])
def test_a_move_to_nowhere_or_to_two_places_is_refused_before_the_arm_gets_power(joints: int, position: int) -> None:
    given = {"joints": [0.0] * joints, "position": [0.0] * position}
    net = load_net(package_file("im_dispatcher", "nets/move.yaml"))
    process = Process([net])
    process.command("move", "move", **net.commands["move"].arguments.check(given, "command move"))
    assert process.recorder.names("move") == ["begin", "refuse+", "refuse", "acknowledge_failure"]
    (result,) = process.results
    assert result.error is not None
    assert result.error.message.startswith("a move is to 9 joint positions or to a position of 3 coordinates")
    assert result.error.message.endswith(f": {joints} and {position} are given")


@pytest.mark.parametrize("name", PATHS)
def test_a_cell_that_is_not_left_as_it_was_found_is_told(name: str) -> None:
    """Where light or power cannot be switched off, a command fails; a calibration, which stands, says so."""
    net = load_net(package_file("im_dispatcher", f"nets/{name}.yaml"))
    ends = [
        each
        for each in net.transitions.values()
        if isinstance(each.action, RequestAction) and each.action.service in {"light_off", "power_down"}
    ]
    assert ends
    for end in ends:
        next_ones = [each for each in net.transitions.values() if set(end.on_failure) & set(each.inputs)]
        noted = all(each.action == FunctionAction("note_left") for each in next_ones)
        assert noted or _ends_in(net, set(end.on_failure)) == {"failed"}, f"{name}: who says that {end.name} failed?"


def _ends_in(net: Net, places: set[str]) -> set[str]:
    """The last words of the symbols that are emitted first on the ways from places."""
    symbols: set[str] = set()
    for _ in net.transitions:
        for each in net.transitions.values():
            if places & set(each.inputs):
                symbols |= set(each.emit)
                places |= set() if each.emit else {*each.outputs, *each.on_failure}
    return {symbol.rpartition("_")[2] for symbol in symbols}
