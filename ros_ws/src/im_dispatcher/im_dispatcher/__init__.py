"""Dispatcher (paper, section 6): receives commands, decomposes commands by nets, and dispatches the steps.

A command is a module of :mod:`im_dispatcher.commands` beside its net in ``nets/``; what it decides is plain Python that
sees the node as a :class:`CommandHost`. Knows the nets (``im_pnt``, ``im_pnt_analysis``) and the cell (``im_cell``);
the Coordinators and what is below them it knows by messages only.
"""

from im_dispatcher.command import CommandDescription, CommandHost

__all__ = ["CommandDescription", "CommandHost"]
