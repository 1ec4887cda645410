"""ROS shell of MCS.

| to learn | open |
|---|---|
| what the node is made of | :mod:`.node` |
| how it lives with its servo process | :mod:`.lifecycle`, :mod:`.servo_keeper` |
| what its servers work with, and how large a message may be | :mod:`.access`, :mod:`.bounds` |
| its actions, topics and services | :mod:`.actions`, :mod:`.topics`, :mod:`.services` |
| what it knows as messages | :mod:`.messages` |
| the way to a robot that speaks ROS | :mod:`.topic_channels` |
"""
