"""Petri net transducers in execution (paper, section 6): the public face of the library.

A net is loaded (:func:`load_net`, :func:`parse_net`), its :class:`Functions` are registered, and an :class:`Executor`
runs it, whose :class:`FunctionRunner` does its actions; an :class:`Observer` is told of firings.
The package ``im_pnt_node`` joins nets with each other, keeps their journal, and makes ROS nodes of them.

Knows ``im_core`` only: no ROS, no network; on disk only net files. Inside, lower knows nothing of
higher: ``model``, ``expression``, then ``netfile`` and ``pnml``, then ``execution``.

A net from the file to a finished command; the examples of the names below go on with its variables:

    >>> import asyncio
    >>> from im_pnt import *
    >>> from im_pnt.execution.jobs import Command
    >>> from im_pnt.execution.notification import Nowhere
    >>> net = parse_net('''
    ... net: oven
    ... places: {cold: 1, hot: , burnt: }
    ... escalate: burnt
    ... transitions:
    ...   bake: {symbol: bake, in: [cold], out: [hot], action: heat}
    ...   empty: {in: [hot], out: [cold], emit: bake_done}
    ...   clean: {in: [burnt], out: [cold], emit: bake_failed}
    ... ''')
    >>> functions = Functions({"heat": lambda ctx: ctx.result.update(degrees=220)})
    >>> runner = FunctionRunner(functions, requests=None, spawn=asyncio.run)  # the net asks no other
    >>> executor = Executor(net, functions, runner, outlet=Nowhere())
    >>> job = executor.command(Command(1, "bake"))
    >>> executor.pump()  # nothing more can fire
    False
    >>> job.closed, job.results, executor.marking()
    (True, {'degrees': 220}, {'cold': 1})
"""

from typing import TYPE_CHECKING

from im_core.plugins import import_at_use

if TYPE_CHECKING:
    from im_pnt.errors import NetError, NetFileError
    from im_pnt.execution.executor import Executor
    from im_pnt.execution.functions import ActionContext, Functions, idempotent, woken_by
    from im_pnt.execution.notification import Firing, Observer
    from im_pnt.execution.runner import FunctionRunner
    from im_pnt.model.net import Net
    from im_pnt.netfile import load_net, parse_net

__all__ = [
    "ActionContext",
    "Executor",
    "Firing",
    "FunctionRunner",
    "Functions",
    "Net",
    "NetError",
    "NetFileError",
    "Observer",
    "idempotent",
    "load_net",
    "parse_net",
    "woken_by",
]

__getattr__ = import_at_use(
    __name__,
    {
        "errors": ("NetError", "NetFileError"),
        "execution.runner": ("FunctionRunner",),
        "execution.executor": ("Executor",),
        "execution.functions": ("ActionContext", "Functions", "idempotent", "woken_by"),
        "execution.notification": ("Firing", "Observer"),
        "model.net": ("Net",),
        "netfile": ("load_net", "parse_net"),
    },
)
