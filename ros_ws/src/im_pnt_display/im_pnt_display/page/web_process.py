"""The process answering visitors of the page, apart from the node showing nets: viewers cannot slow the machine.

It takes the listening sockets of the display, and a socket to the display: the token, the state and pieces with its
changes come there, and what viewers want done goes back, with how many they are. It ends with that socket.
"""

import asyncio
import json
import os
import socket
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress

from im_pnt_display.page.site import Site
from im_pnt_display.page.state import DisplayState
from im_pnt_display.page.viewers import END_OF_PIECE, Viewers

_LONGEST_PIECE = 2**30
"""Longest piece on the link, a snapshot of all nets [bytes]."""
_NICENESS = 10
"""Priority below that of the machine's processes."""


async def answer_visitors(host: str, link: socket.socket, listening: Sequence[socket.socket]) -> None:
    """Answer visitors until the display closes the link."""
    reader, writer = await asyncio.open_connection(sock=link, limit=_LONGEST_PIECE)

    def operate(wanted: Mapping[str, str]) -> None:
        if not writer.is_closing():
            writer.write(f"{json.dumps(wanted)}\n".encode())

    def count(*numbers: int) -> None:
        operate({"net": "", "request": "audience", "argument": json.dumps(numbers)})

    viewers = Viewers(DisplayState(), count)
    token = (await reader.readline()).decode().strip()
    site = Site(host, viewers, operate, token=token)
    stop = asyncio.Event()
    async with asyncio.TaskGroup() as group:
        with suppress(asyncio.IncompleteReadError, ConnectionError):
            viewers.relay((await reader.readuntil(END_OF_PIECE)).removesuffix(END_OF_PIECE))
            group.create_task(site.serve(listening, stop))
            while True:
                viewers.relay((await reader.readuntil(END_OF_PIECE)).removesuffix(END_OF_PIECE))
        stop.set()


def main(arguments: Sequence[str]) -> None:
    """Run the process: host, and descriptors of the link and of the listening sockets."""
    os.nice(_NICENESS)
    host, *descriptors = arguments
    link, *listening = (socket.socket(fileno=int(each)) for each in descriptors)
    asyncio.run(answer_visitors(host, link, listening))


if __name__ == "__main__":
    main(sys.argv[1:])
