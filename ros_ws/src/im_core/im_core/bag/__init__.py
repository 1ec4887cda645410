"""A bag (rosbag2) that somebody hands over: completed where its recorder was killed, and read.

- :mod:`.contents`: what an MCAP file holds, record by record, and the end that belongs to it.
- :mod:`.files`: the files of a bag and ``metadata.yaml``; what a recorder that was killed has left is completed.
- :mod:`.storage`: MCAP files whose index leaves something out, for ``rosbags``.
- :mod:`.reading`: decoded messages.
- :mod:`.command_line`: of whatever works on one bag.
"""
