"""Additions of other packages to ``pnt``: packages above im_pnt_analysis name the commands as entry points."""

from collections.abc import Callable, Iterator
from typing import Any


def extensions(group: str, name: str | None = None) -> Iterator[Callable[..., Any]]:
    """Yield the entry points of a group, in the order of the names.

    Args:
        group: ``im_pnt.commands``: functions that add a command to the parser; ``im_pnt.counterexamples``: functions
            that make a drawing for the page of nets and a firing sequence; ``im_pnt.programs``: functions that take
            a command line and the name of the program; ``im_pnt.message_types``: types of messages;
            ``im_pnt.resources``: functions that return the names of the resources of a cell.
        name: The entry point of this name alone; None: all.
    """
    from importlib.metadata import entry_points  # takes longer than many a command, most of which need none

    chosen = entry_points(group=group) if name is None else entry_points(group=group, name=name)
    for entry in sorted(chosen, key=lambda entry: entry.name):
        yield entry.load()
