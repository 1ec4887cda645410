"""Bags of ROS messages: MCAP; messages pass as the bytes the middleware delivers.

- :mod:`im_bringup.bag.writer`: parts, chunks, and the disk that is full;
- :mod:`im_bringup.bag.definitions`: the texts of all types of a bag;
- :mod:`im_bringup.bag.reader`: messages in their order, of one topic or several;
- :mod:`im_bringup.bag.playback`: the pace of a replay.
"""

from im_bringup.bag.delivery import Delivery
from im_bringup.bag.reader import BagReader, chosen_topics, default_folder
from im_bringup.bag.writer import BagWriter, PartLimits

__all__ = ["BagReader", "BagWriter", "Delivery", "PartLimits", "chosen_topics", "default_folder"]
