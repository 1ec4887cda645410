"""Recordings of ROS messages (rosbag2): written, completed after the death of the recorder, read, and played.

| to learn | open |
|---|---|
| records of an MCAP file, and the end that belongs to it | :mod:`.contents`, :mod:`.unpacking` |
| files of a bag, ``metadata.yaml``, completion after a kill | :mod:`.files` |
| MCAP files with an incomplete index | :mod:`.storage` |
| decoded messages; messages as the bytes of the middleware | :mod:`.reading`; :mod:`.raw` |
| parts, chunks, types, and the disk that is full | :mod:`.writer`, :mod:`.chunks`, :mod:`.definitions` |
| the pace of a replay | :mod:`.playback` |
| the recorder and the replay as ROS nodes | :mod:`.ros` |

Knows ``im_core`` only.
"""

from typing import TYPE_CHECKING

from im_core.plugins import import_at_use

if TYPE_CHECKING:
    from im_bag.delivery import Delivery
    from im_bag.raw import BagReader, chosen_topics, default_folder
    from im_bag.writer import BagWriter, PartLimits

__all__ = ["BagReader", "BagWriter", "Delivery", "PartLimits", "chosen_topics", "default_folder"]

__getattr__ = import_at_use(
    __name__,
    {
        "delivery": ("Delivery",),
        "raw": ("BagReader", "chosen_topics", "default_folder"),
        "writer": ("BagWriter", "PartLimits"),
    },
)
