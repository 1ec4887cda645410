"""Re-run of a recorded mission: no robot, no ROS node (``docs/replay.md``).

:mod:`.log` is what a node tells while it runs, :mod:`.host` what functions of nets may use of their node so that they
can be run again, :mod:`.stream` reads what was told, :mod:`.rerun` runs the nets on it, firing by firing. For that
:mod:`.progress` keeps how far they have come and where they differ, :mod:`.engine` begins and ends their actions, and
:mod:`.script` stands for the world.
"""
