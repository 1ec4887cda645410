"""The commands of the Dispatcher, a module each beside its net: ``commands/foo.py`` and ``nets/foo.yaml`` make one.

A module describes its command as ``COMMAND``. What decides is plain Python; data objects are translated in
:mod:`im_dispatcher.ros.host`.
"""

import pkgutil

from im_core import plugins
from im_core.errors import ConfigError
from im_dispatcher.command import CommandDescription


def installed() -> list[CommandDescription]:
    """Every command there is, by name.

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
