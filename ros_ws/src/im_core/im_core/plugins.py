"""Loader of objects named ``module:Class`` in configuration, and of the public names of packages."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, overload

from im_core.errors import FOREIGN, ConfigError, ImError

ClassT = TypeVar("ClassT")

#: What the files of modules were when these were imported: time of the last change [ns] and size.
_imported: dict[str, tuple[int, int] | None] = {}
_beside: list[Path] = []


@overload
def load(reference: str, contract: type[ClassT], what: str) -> type[ClassT]: ...
@overload
def load(reference: str, contract: None, what: str) -> object: ...


def load(reference: str, contract: type[object] | None, what: str) -> object:
    """Load the object named by a reference.

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
        imported = import_module(module)
        _require_unhidden(module.partition(".")[0])
        _imported.setdefault(module, _stamp(imported))
        found: object = getattr(imported, name)
    except FOREIGN as error:  # a module of the user's may raise anything
        known = isinstance(error, ImportError | AttributeError | ValueError)
        why = str(error) if known else f"{type(error).__name__}: {error}"
        if isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]:
            why += " (its folder belongs into PYTHONPATH)"
        form = "module:Class or module:function" if contract is None else "module:Class"
        sentence = f"{what} '{reference}' cannot be loaded: {why}; it is written {form}"
        raise ConfigError(sentence, what=what, reference=reference) from error
    if contract is not None and not (isinstance(found, type) and issubclass(found, contract)):
        raise ConfigError(f"{what} '{reference}' is no {contract.__name__}", what=what, reference=reference)
    return found


def extensions(group: str, name: str | None = None) -> Iterator[Callable[..., Any]]:
    """Yield the entry points of a group, additions of other packages, in the order of the names.

    Args:
        group: ``im_pnt.commands``: functions that add a command to the parser; ``im_pnt.counterexamples``: functions
            that make a drawing for the page of nets and a firing sequence; ``im_pnt.programs``: functions that take
            a command line and the name of the program; ``im_pnt.message_types``: types of messages;
            ``im_pnt.resources``: functions that return the names of the resources of a cell; ``im_pnt.parameters``:
            functions that return values for ``parameters`` of net files by name.
        name: The entry point of this name alone; None: all.
    """
    for entry in _entries(group):
        if name in (None, entry.name):
            yield entry.load()


@cache
def _entries(group: str) -> Sequence[Any]:
    """Return the entry points of a group by name: each net that is read asks."""
    return sorted(all_entries().select(group=group), key=lambda entry: entry.name)


@cache
def all_entries() -> Any:
    """Return the entry points of all groups, read once: hundreds of files tell them."""
    from importlib.metadata import entry_points  # takes longer than many a command, most of which need none

    return entry_points()


def make(reference: str, what: str, *arguments: object) -> object:
    """Call the class or function named by a reference.

    Args:
        reference: As of :func:`load`.
        what: As of :func:`load`.
        *arguments: What to call it with.

    Raises:
        ConfigError: It cannot be loaded or called, or refuses the arguments; the message names it.
    """
    factory = load(reference, None, what)
    try:
        if not callable(factory):
            raise TypeError("a class or a function is needed, not a value")
        return factory(*arguments)
    except ConfigError as error:
        refused = ConfigError(f"{what} '{reference}': {error.message}", reference=reference)
        refused.facts.update(error.facts)
        raise refused from error
    except ImError:
        raise
    except FOREIGN as error:
        sentence = f"{what} '{reference}' cannot be loaded: {type(error).__name__}: {error}"
        raise ConfigError(sentence, reference=reference) from error


def find_beside(files: Iterable[str | Path]) -> None:
    """Find modules beside some files too, for the rest of the process; behind all others, which they cannot hide."""
    folders = dict.fromkeys(str(Path(file).resolve().parent) for file in files)
    _beside[:] = map(Path, folders)
    sys.path[:] = [*(each for each in sys.path if each not in folders), *folders]


def _require_unhidden(name: str) -> None:
    """Check whether an imported module is the one beside the files of :func:`find_beside`, if that has one.

    Raises:
        ImportError: It is another one of the same name.
    """
    file = getattr(sys.modules[name], "__file__", None)
    for own in (own for folder in _beside for own in (folder / f"{name}.py", folder / name / "__init__.py")):
        if own.is_file() and (file is None or not own.samefile(file)):
            raise ImportError(f"{own} is hidden by {file or 'a module of Python'}; give it another name")


def require_current(reference: str, what: str) -> None:
    """Check a loaded module's file for changes: Python imports each module once.

    Args:
        reference: As of :func:`load`; of a module that was not loaded nothing is said.
        what: As of :func:`load`.

    Raises:
        ConfigError: It was changed.
    """
    module = reference.partition(":")[0]
    before = _imported.get(module)
    if before is not None and _stamp(import_module(module)) != before:
        raise ConfigError(
            f"{what} '{reference}': the file of module {module} was changed after this process imported "
            "it; restart the process to use the changed file",
            what=what,
            reference=reference,
        )


def import_at_use(package: str, names: Mapping[str, Sequence[str]]) -> Callable[[str], object]:
    """Make the ``__getattr__`` of a package: import a public name at the first use, without the other modules."""
    modules = {name: module for module, given in names.items() for name in given}

    def find(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package} has no {name}")
        return getattr(import_module(f"{package}.{modules[name]}"), name)

    return find


def _stamp(module: ModuleType) -> tuple[int, int] | None:
    """Return a stamp of the file of a module; None: the module has no file."""
    try:
        told = os.stat(getattr(module, "__file__", None) or "")
    except OSError:
        return None
    return told.st_mtime_ns, told.st_size
