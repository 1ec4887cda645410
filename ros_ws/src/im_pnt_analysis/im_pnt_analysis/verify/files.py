"""Faults of net files by themselves: commands without an end, missing resources and functions.

A node finds these when it loads a net, or when a command fails; verification tells them before.
"""

from collections.abc import Collection, Iterable, Iterator, Sequence

from im_core import plugins
from im_core.errors import ConfigError, nearest
from im_pnt.errors import NetFileError
from im_pnt.execution.jobs import DONE_SUFFIX, FAILED_SUFFIX
from im_pnt.model.net import Net, Transition
from im_pnt.model.resource_use import choices_of, filled, named_arguments, possible, values_of


def check_files(nets: Sequence[Net], resources: Collection[str]) -> list[str]:
    """Check the commands, resources and functions of nets.

    Args:
        nets: The nets as written.
        resources: What the cell has, beside what the nets act on; empty: no cell is known.

    Returns:
        A sentence for each symbol, of which no net declares a command, that ends no command.

    Raises:
        NetFileError: A command never ends, needs what nothing has, or a ``module:function`` cannot be imported.
    """
    for net in nets:
        _check_functions(net)
        _check_needs(net, nets, resources)
    return [sentence for net in nets for sentence in _endless(net, nets)]


def _check_functions(net: Net) -> None:
    for transition in net.transitions.values():
        named = [("guard", transition.guard.name)] if transition.guard else []
        named += [("action", name) for name in (transition.action.functions if transition.action else ())]
        for kind, name in named:
            if ":" in name and "${" not in name:
                try:
                    plugins.load(name, None, f"{kind} function")
                except ConfigError as error:
                    raise _error(net, transition, error.message) from error


def _endless(net: Net, nets: Sequence[Net]) -> Iterator[str]:
    """Yield the symbols that no transition acknowledges; refuse those that are declared, or misspelt."""
    if any(t.remote_outputs for t in net.transitions.values()) and net.partners() - {other.name for other in nets}:
        return  # a net that is not here may end the command
    emitted = {symbol for other in nets for t in other.transitions.values() for symbol in t.emit}
    read = {symbol for other in nets for symbol in other.symbols()}
    for symbol in net.begun_symbols():
        if f"{symbol}{DONE_SUFFIX}" in emitted:
            continue
        strangers = sorted(name for name in emitted if _ended(name) and _ended(name) not in read)
        sentence = f"command {symbol} never ends well: no transition emits {symbol}{DONE_SUFFIX}"
        if strangers or symbol in net.commands:
            reader = next(t for t in net.transitions.values() if t.symbol == symbol)
            meant = f"; {', '.join(strangers)} is of no command" if strangers else ""
            raise _error(net, reader, f"{sentence}{meant}")
        yield sentence


def _ended(emitted: str) -> str:
    """Return the symbol whose command an output symbol ends, by its form; empty for other symbols."""
    suffix = next((suffix for suffix in (DONE_SUFFIX, FAILED_SUFFIX) if emitted.endswith(suffix)), None)
    return emitted.removesuffix(suffix) if suffix else ""


def _check_needs(net: Net, nets: Sequence[Net], resources: Collection[str]) -> None:
    """Refuse the need of a missing resource: neither of the cell, nor used by a net."""
    acted_on, all_known = _acted_on(nets)
    known = {*resources, *acted_on, *(place for other in nets for place in other.places)}
    for symbol, command in net.commands.items():
        for choice in choices_of(command.arguments, named_arguments(command.needs)):
            for need in command.needs:
                if set(named_arguments([need])) - choice.keys():
                    continue  # of an argument without choices anything may come
                name = filled(need, choice)
                hint = nearest(name, known)
                if name and name not in known and ((resources and all_known) or "did you mean" in hint):
                    reader = next(t for t in net.transitions.values() if t.symbol == symbol)
                    sentence = f"command {symbol} needs '{name}', which no cell has and nothing acts on{hint}"
                    raise _error(net, reader, sentence)


def _acted_on(nets: Iterable[Net]) -> tuple[set[str], bool]:
    """Return the resources that services and transitions act on, and whether choices tell all of them."""
    found: set[str] = set()
    all_known = True
    for net in nets:
        declared = [None, *(service.arguments for service in net.services.values())]
        declared += [command.arguments for command in net.commands.values()]
        said = [service.acts_on for service in net.services.values()]
        said += [transition.acts_on for transition in net.transitions.values()]
        for names in filter(None, said):
            told = [options for schema in declared if (options := possible(list(names), values_of(schema))) is not None]
            found.update(*told)
            all_known = all_known and bool(told)
    return found, all_known


def _error(net: Net, transition: Transition, sentence: str) -> NetFileError:
    where = f"transitions.{transition.name}: {sentence}"
    return NetFileError(transition.file or net.source, transition.line, where)
