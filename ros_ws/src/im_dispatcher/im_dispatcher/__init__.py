"""Dispatcher (paper, section 6): receives commands, decomposes commands by nets, and dispatches the steps.

A command is a module of :mod:`im_dispatcher.commands` beside its net in ``nets/``; what it decides is plain Python that
sees the node as a :class:`im_pnt_node.rerun.host.Host`. Knows the nets (``im_pnt``, ``im_pnt_node``,
``im_pnt_analysis``) and the cell (``im_cell``); the Coordinators and what is below them it knows by messages only.
"""

from im_dispatcher.command import CommandDescription

__all__ = ["CommandDescription"]
