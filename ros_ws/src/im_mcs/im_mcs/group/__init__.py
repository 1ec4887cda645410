"""One group of joints under control: from a goal to the result, and from setpoints to torques.

| to learn | open |
|---|---|
| what a group is asked for, and what it does in a tick | :mod:`.group` |
| motions that wait, are prepared and begin | :mod:`.motion_queue`, :mod:`.goals` |
| pauses, speeds and stops | :mod:`.rates` |
| streams of clients | :mod:`.streams` |
| when a goal is reached, and when an arm rests | :mod:`.goal_check`, :mod:`.rest_monitor` |
"""

from im_mcs.group.group import ControlledGroup

__all__ = ["ControlledGroup"]
