"""Servo loop: all layers of Figure 6 once a tick, in a separate process without ROS (``python -m im_mcs.servo``).

| to learn | open |
|---|---|
| what happens in one tick, from reading the slots to writing the slots | :mod:`.core` |
| what calls it: the loop, its deadlines, the end | :mod:`.process`, :mod:`im_core.rate_groups` |
| functions of the user's at servo rate | :mod:`.functions` |
| how setpoints become torques | :mod:`.control_loop`, :mod:`im_mcs.group`, :mod:`.gripper`, :mod:`.partition` |
| what becomes of requests, and what is answered | :mod:`.dispatch`, :mod:`.answers`, :mod:`.report` |
| torques of clients | :mod:`.torque_stream` |
| how simulated time waits for an owner at clock factor 0 | :mod:`.awaited` |
"""
