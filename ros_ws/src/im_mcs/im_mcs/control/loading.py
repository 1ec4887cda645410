"""Control laws by name."""

import importlib

from im_core.errors import ConfigError, ImError
from im_mcs.control.controller import Controller, ControllerSetup
from im_mcs.control.guard import GuardedLaw


def load_controller(name: str, setup: ControllerSetup) -> Controller:
    """Make the control law that the configuration names ``module:Class``.

    Raises:
        ConfigError: There is no such module or class, or it refuses its parameters.
    """
    module_name, _, class_name = name.partition(":")
    try:
        factory = getattr(importlib.import_module(module_name), class_name)
        return GuardedLaw(name, factory(setup))
    except ImError:
        raise
    except Exception as error:  # a module of the user's may raise anything
        raise ConfigError(
            f"controller '{name}' cannot be loaded: {type(error).__name__}: {error}; it is written module:Class",
            controller=name,
        ) from error
