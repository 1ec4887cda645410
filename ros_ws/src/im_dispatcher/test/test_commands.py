"""The commands of the Dispatcher: a module and a net each."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from im_core.errors import ConfigError
from im_dispatcher import commands
from im_dispatcher.command import joined
from im_pnt.execution.functions import Functions
from im_pnt.netfile import load_net

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

COMMAND = CommandDescription(
    net=Path(__file__).parent.parent / "nets/wave.yaml",
    functions=lambda host: Functions({"wave": lambda ctx: host.warn("waving")}),
)
"""


class Host:
    """Of a node, only its log."""

    def __init__(self) -> None:
        self.log: list[str] = []

    def warn(self, text: str) -> None:
        self.log.append(text)

    def time_steps(self, times: object) -> None:
        pass


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder whose modules are commands, too."""
    for name in ("commands", "nets"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(commands, "__path__", [*commands.__path__, str(tmp_path / "commands")])
    yield tmp_path
    for name in ("wave", "broken"):
        sys.modules.pop(f"{commands.__name__}.{name}", None)


def test_every_net_that_is_shipped_belongs_to_a_command_whose_functions_it_names() -> None:
    found = commands.installed()
    nets = {command.net.resolve() for command in found}
    assert nets == {path.resolve() for path in (Path(commands.__file__).parent.parent / "nets").glob("*.yaml")}
    for command in found:
        command.functions(Host()).check(load_net(command.net))


def test_a_command_is_added_by_a_module_and_a_net(folder: Path) -> None:
    (folder / "commands/wave.py").write_text(MODULE)
    (folder / "nets/wave.yaml").write_text(NET)
    (wave,) = [command for command in commands.installed() if command.net.name == "wave.yaml"]
    net, host = load_net(wave.net), Host()
    functions = wave.functions(host)
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
