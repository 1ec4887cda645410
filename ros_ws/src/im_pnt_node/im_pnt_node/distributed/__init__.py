"""Nets in several processes: remote places, requests, and the link with exactly-once delivery.

:class:`Exchange` delivers tokens, requests and replies between the nets of a process to their :mod:`.inboxes`, keeps
the :mod:`.requests` that wait, tells the journal of both (:mod:`.entries`), and hands messages for others to a
:class:`Transport`; :class:`Link` is what carries them, over two :mod:`.streams` of :mod:`.packets` for each process.
All of it is written as :mod:`.codec` says.
"""

from im_pnt_node.distributed.exchange import Exchange, Transport
from im_pnt_node.distributed.link import Link

__all__ = ["Exchange", "Link", "Transport"]
