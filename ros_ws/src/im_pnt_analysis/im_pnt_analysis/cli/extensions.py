"""What other packages add to ``pnt``: drawings are a package above this one, and name themselves as entry points."""

from collections.abc import Callable, Iterator
from typing import Any


def extensions(group: str) -> Iterator[Callable[..., Any]]:
    """Yields what installed packages offer under the name of a group, in the order of its names.

    Args:
        group: ``im_pnt.commands``: functions that add a command to the parser; ``im_pnt.counterexamples``: functions
            that make of nets and a firing sequence what the page draws.
    """
    from importlib.metadata import entry_points  # takes longer than many a command, most of which need none

    for entry in sorted(entry_points(group=group), key=lambda entry: entry.name):
        yield entry.load()
