"""Run commands beside each other with asyncio; both arms go home at the same time."""

import asyncio

from im import Machine


async def main() -> None:
    """Begin two commands, and await both."""
    with Machine.connect() as im:
        left, right = (im.run("home", wait=False, group=group) for group in ("left", "right"))
        await asyncio.gather(left, right)
        print("home:", left, right)


asyncio.run(main())
