"""Nets to look at: drawings, and a web page showing live nets and playing counterexamples.

For whoever watches a machine or writes about a net. Knows ``im_core``, ``im_bag``, the model and files of ``im_pnt``,
and the replay and command line of ``im_pnt_analysis``; nobody knows it: ``pnt`` finds what it adds by entry points.
"""

from typing import TYPE_CHECKING

from im_pnt_display.drawing.draw import Drawing, dot, draw, svg

if TYPE_CHECKING:
    from im_pnt_display.page.server import DisplayServer

__all__ = ["DisplayServer", "Drawing", "dot", "draw", "svg"]


def __getattr__(name: str) -> object:
    """Import the server at the first use: a drawing should not wait for the libraries of a web page."""
    if name != "DisplayServer":
        raise AttributeError(f"module {__name__} has no {name}")
    from im_pnt_display.page.server import DisplayServer

    return DisplayServer
