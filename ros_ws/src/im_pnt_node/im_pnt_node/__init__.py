"""Nets as communicating, lasting ROS nodes: remote places, journal, re-run, the node, and ``pnt run``.

An :class:`Exchange` joins the nets of a process with each other and with those of other processes; a :class:`Journal`
brings them back after the death of the process. The ROS node is :class:`im_pnt_node.ros.node.PntNode`; this face does
not import it, because it needs ROS.

Knows ``im_core``, ``im_bag`` and ``im_pnt``. Folders, from the lowest: ``distributed`` (packets, links, streams),
``journal`` (a log written ahead), ``rerun`` (a recorded run, run again), ``scenario`` (nets with mocked actions),
``ros`` (the node), and commands of ``pnt`` in ``cli``.
"""

from typing import TYPE_CHECKING

from im_core.plugins import import_at_use

if TYPE_CHECKING:
    from im_pnt_node.distributed.exchange import Exchange
    from im_pnt_node.journal.journal import Journal

__all__ = ["Exchange", "Journal"]

__getattr__ = import_at_use(__name__, {"distributed.exchange": ("Exchange",), "journal.journal": ("Journal",)})
