"""Journal of a process with nets: written ahead, checksummed, compacted; restores everything after a kill.

:class:`Journal` collects what nets, exchange and link tell it, as :mod:`im_pnt_node.distributed.codec` writes it, and
appends it to the :mod:`.log` in a :mod:`.folder`; :mod:`.state` has the snapshots that a log begins with.
"""

from im_pnt_node.journal.journal import Journal
from im_pnt_node.journal.log import Sync

__all__ = ["Journal", "Sync"]
