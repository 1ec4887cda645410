"""The commands of the Dispatcher: a net each in ``nets/``, and a module here where one needs functions.

``commands/foo.py`` describes the functions of ``nets/foo.yaml`` as ``COMMAND``. What decides is plain Python; data
objects are JSON data of a named type of message.
"""

import pkgutil
from collections.abc import Iterable, Mapping
from pathlib import Path

from im_core import plugins
from im_core.errors import ConfigError, NotFoundError
from im_core.message_paths import message_folders, resolve_below
from im_dispatcher.command import CommandDescription
from im_pnt.description import describe_commands
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, load_present, parse_net

NETS = Path(__file__).parent.parent / "nets"

SHIPPED = "shipped"
"""Name of all shipped commands together."""


def shipped() -> list[str]:
    """Return names of the shipped commands, equal to the names of the net files."""
    return sorted(path.stem for path in NETS.glob("*.yaml"))


def net_files(named: Iterable[str]) -> list[Path]:
    """The net files of commands.

    Args:
        named: ``shipped`` for all shipped commands, names of some, paths of net files, and of folders of them.

    Raises:
        ConfigError: There is no such command, file or folder, or no net file in the folder; or nothing is named.
    """
    files: list[Path] = []
    for name in filter(None, (each.strip() for each in named)):
        path = Path(name)
        if "/" not in name and not path.suffix:
            names = shipped() if name == SHIPPED else [name]
            if not set(names) <= set(shipped()):
                missing = NotFoundError(kind="command that is shipped", name=name, known=[SHIPPED, *shipped()])
                raise ConfigError(f"{missing.message}; a folder of net files is meant by ./{name}", name=name)
            found = [NETS / f"{each}.yaml" for each in names]
        elif path.is_dir():
            found = sorted(path.glob("*.yaml"))
            if not found:
                raise ConfigError(f"{path}: there is no net file (*.yaml) in this folder", file=str(path))
        elif path.is_file():
            found = [path]
        else:
            raise ConfigError(f"{path}: there is no such net file or folder", file=str(path))
        files += [file for file in found if file not in files]
    if not files:
        known = f"{SHIPPED}, or names of {', '.join(shipped())}"
        raise ConfigError(f"no command is named: give net files, folders of them, {known}")
    return files


def describe_named(named: Iterable[str]) -> dict[str, object]:
    """Return the description of commands from the net files, as a dispatcher publishes on ``/dispatcher/commands``.

    Args:
        named: As of :func:`net_files`.

    Raises:
        ConfigError: As of :func:`net_files`.
        NetFileError: A file is not a net.
    """
    return describe_commands(*load_present(net_files(named)))


def load_named_net(path: str) -> Net:
    """Read a net file named by a message; shipped, or below the folders allowed for messages.

    Args:
        path: The file, as of :func:`im_pnt.netfile.load_net`. What it includes lies below the same folders.

    Raises:
        DataError: It is outside of those folders.
        NetFileError: It is not a net.
    """
    folders = [*message_folders(), NETS]
    name, mark, part = path.partition("#")
    place = resolve_below(name, folders, "net_file")
    return load_net(f"{place}{mark}{part}", folders)


def parse_sent_net(text: str, sent: Mapping[str, str]) -> Net:
    """Read a net from the text in a message; it may include the sent files, and the shipped ``parts/power.yaml``.

    Args:
        text: The text.
        sent: Texts of the sent files, by the path from the folder of the net.

    Raises:
        NetFileError: It is not a net.
    """
    return parse_net(text, file=NETS / "net", within=[NETS], sent=sent)


def installed() -> list[CommandDescription]:
    """Return the descriptions of commands with functions, by name.

    Raises:
        ConfigError: A module in this folder describes none, or cannot be imported.
    """
    found = []
    for module in sorted(pkgutil.iter_modules(__path__), key=lambda module: module.name):
        reference = f"{__name__}.{module.name}:COMMAND"
        command = plugins.load(reference, None, "command")
        if not isinstance(command, CommandDescription):
            raise ConfigError(f"{reference} is no {CommandDescription.__name__}", reference=reference)
        found.append(command)
    return found
