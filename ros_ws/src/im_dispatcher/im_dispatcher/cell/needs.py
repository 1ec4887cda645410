"""Resources of the cell, and needs of commands: for each command, and each choice of the deciding arguments."""

import itertools
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from im_cell.robot import Cell, load_cell
from im_core.errors import NotFoundError
from im_pnt.errors import NetError
from im_pnt.model.arguments import CommandDeclaration
from im_pnt.model.groups import require_one_reader
from im_pnt.model.net import Net
from im_pnt.model.resource_use import filled, named_arguments, require_told, shown

MOST_VARIANTS = 200
"""Of one command: what an arm, a camera and a light decide together."""

ZONE, LASER = "zone", "laser"
"""Where the arms can meet, and what one command at a time points."""


def resources_of(cell: Cell) -> tuple[str, ...]:
    """Return the resources of a cell: arm, gripper and light of each group, cameras, laser, zone."""
    found: list[str] = []
    for name, group in cell.groups.items():
        there = {"arm": True, "gripper": group.gripper, "led": group.light}
        found += [f"{name}_{part}" for part, has in there.items() if has]
    return (*found, *cell.cameras, *([LASER] if cell.laser else []), ZONE)


def cell_resources() -> tuple[str, ...]:
    """Return the resources of the shipped cell."""
    return resources_of(load_cell())


@dataclass(frozen=True)
class Variant:
    """Command with a choice of the arguments relevant for the resources.

    Attributes:
        name: Its transition of the net ``cell``.
        symbol: The command.
        net: The net that does it.
        choice: Those arguments.
        needs: The resources, each once.
        declared: What its net says of it.
    """

    name: str
    symbol: str
    net: str
    choice: Mapping[str, object] = field(hash=False)
    needs: tuple[str, ...]
    declared: CommandDeclaration = field(hash=False)

    def is_meant(self, arguments: Mapping[str, object]) -> bool:
        """Return whether arguments, with the defaults, have the variant's choice."""
        return all(arguments.get(name) == value for name, value in self.choice.items())


class Needs:
    """Needs of the commands of some nets.

    Args:
        nets: The nets; a command that declares no needs is not among these.
        resources: What there is.

    Raises:
        NetError: Two nets have the same command, an argument that decides has no choices, or a transition does not say
            what it acts on: beside commands that hold things, one that needs nothing must say that it moves nothing.
        NotFoundError: A command needs what there is not.
    """

    def __init__(self, nets: Iterable[Net], resources: Sequence[str]) -> None:
        self.resources = tuple(resources)
        self.variants: dict[str, Variant] = {}
        nets = list(nets)
        require_one_reader(nets)
        for net in nets:
            require_told(net)
            for symbol, declared in net.commands.items():
                if not declared.needs:
                    continue
                for variant in _variants(net, symbol, declared, self.resources):
                    if variant.name in self.variants:
                        raise NetError(f"two commands would be the transition {variant.name} of the net cell")
                    self.variants[variant.name] = variant

    def __contains__(self, symbol: str) -> bool:
        """Whether a command takes something."""
        return any(variant.symbol == symbol for variant in self.variants.values())

    def declared(self, symbol: str) -> CommandDeclaration:
        """Return the declaration of a command with resources."""
        return next(variant.declared for variant in self.variants.values() if variant.symbol == symbol)

    def declared_by(self, symbol: str) -> str:
        """Return the net of the declaration."""
        return next(variant.net for variant in self.variants.values() if variant.symbol == symbol)

    def variant(self, symbol: str, arguments: Mapping[str, object]) -> Variant:
        """Return the variant of a command for the given arguments.

        Raises:
            NetError: Nothing; its arguments were not checked.
        """
        for variant in self.variants.values():
            if variant.symbol == symbol and variant.is_meant(arguments):
                return variant
        raise NetError(f"command {symbol} with {str(dict(arguments))[:200]} needs nobody knows what", symbol=symbol)


def _variants(net: Net, symbol: str, declared: CommandDeclaration, resources: Collection[str]) -> list[Variant]:
    where = f"{net.source or net.name}: commands.{symbol}.needs"
    deciding = named_arguments(declared.needs)
    choices: list[Sequence[object]] = []
    for name in deciding:
        argument = declared.arguments.arguments.get(name)
        if argument is None:
            raise NotFoundError(kind=f"argument of {where}", name=name, known=declared.arguments.arguments)
        if argument.type.is_list or not argument.choices:
            raise NetError(f"{where}: argument {name} decides what is needed, so it is to be one value of `choices`")
        choices.append(argument.choices)
    found = []
    for chosen in itertools.islice(itertools.product(*choices), MOST_VARIANTS + 1):
        choice = dict(zip(deciding, chosen, strict=True))
        needs = tuple(dict.fromkeys(text for need in declared.needs if (text := filled(need, choice))))
        for need in needs:
            if need not in resources:
                raise NotFoundError(kind=f"resource of the cell ({where})", name=need, known=resources)
        name = "_".join([symbol, *(re.sub(r"\W", "_", shown(value)) for value in chosen)])
        found.append(Variant(name, symbol, net.name, choice, needs, declared))
    if len(found) > MOST_VARIANTS:
        raise NetError(f"{where}: its arguments have more than {MOST_VARIANTS} choices together")
    return found
