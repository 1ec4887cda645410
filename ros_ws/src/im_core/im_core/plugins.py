"""The loader of what configuration names as ``module:Class``: control laws, drivers, vision services, commands."""

from importlib import import_module
from typing import TypeVar, overload

from im_core.errors import FOREIGN, ConfigError

ClassT = TypeVar("ClassT")


@overload
def load(reference: str, contract: type[ClassT], what: str) -> type[ClassT]: ...
@overload
def load(reference: str, contract: None, what: str) -> object: ...


def load(reference: str, contract: type[object] | None, what: str) -> object:
    """Find what a reference names.

    Args:
        reference: ``module:Class``; the module may be any that Python can import.
        contract: Class that it must be a subclass of; None: anything will do, a function, too.
        what: What is looked for, for the message, e.g. ``channel driver``.

    Raises:
        ConfigError: It is not written so, there is no such module, it fails while it is imported, it has no such
            class, or the class is none of the contract.
    """
    module, colon, name = reference.partition(":")
    try:
        if not (module and colon and name):
            raise ValueError("module or class is missing")
        found: object = getattr(import_module(module), name)
    except FOREIGN as error:  # a module of the user's may raise anything
        known = isinstance(error, ImportError | AttributeError | ValueError)
        why = str(error) if known else f"{type(error).__name__}: {error}"
        sentence = f"{what} '{reference}' cannot be loaded: {why}; it is written module:Class"
        raise ConfigError(sentence, what=what, reference=reference) from error
    if contract is not None and not (isinstance(found, type) and issubclass(found, contract)):
        raise ConfigError(f"{what} '{reference}' is no {contract.__name__}", what=what, reference=reference)
    return found
