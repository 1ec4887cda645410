"""Petri net transducers in execution (paper, section 6): what a user of the library may rely on.

A net is loaded (:func:`load_net`, :func:`parse_net`), its :class:`Functions` are registered, and an :class:`Executor`
runs it, whose :class:`FunctionRunner` does its actions; an :class:`Exchange` joins the nets of a process with each
other and those of others, an :class:`Observer` is told of firings, and a :class:`Journal` brings them back.
The ROS node that has all this is :class:`im_pnt.ros.node.PntNode`; it is not imported here, for it needs ROS.

Knows ``im_core`` only. Inside, lower knows nothing of higher: ``model``, ``expression``, then ``netfile`` and
``pnml``, then ``execution``, ``distributed``, ``journal``, ``ros``.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from im_pnt.distributed.exchange import Exchange
    from im_pnt.errors import NetError, NetFileError
    from im_pnt.execution.actions import FunctionRunner
    from im_pnt.execution.executor import Executor
    from im_pnt.execution.functions import ActionContext, Functions, idempotent, woken_by
    from im_pnt.execution.notification import Firing, Observer
    from im_pnt.journal.journal import Journal
    from im_pnt.model.net import Net
    from im_pnt.netfile import load_net, parse_net

__all__ = [
    "ActionContext",
    "Exchange",
    "Executor",
    "Firing",
    "FunctionRunner",
    "Functions",
    "Journal",
    "Net",
    "NetError",
    "NetFileError",
    "Observer",
    "idempotent",
    "load_net",
    "parse_net",
    "woken_by",
]

_FACE = {
    "distributed.exchange": ("Exchange",),
    "errors": ("NetError", "NetFileError"),
    "execution.actions": ("FunctionRunner",),
    "execution.executor": ("Executor",),
    "execution.functions": ("ActionContext", "Functions", "idempotent", "woken_by"),
    "execution.notification": ("Firing", "Observer"),
    "journal.journal": ("Journal",),
    "model.net": ("Net",),
    "netfile": ("load_net", "parse_net"),
}


def __getattr__(name: str) -> object:
    """Imports what is asked for; who needs only the model waits for no reader of files and no journal."""
    for module, names in _FACE.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__} has no {name}")
