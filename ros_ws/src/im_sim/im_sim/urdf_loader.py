"""Load the text of a URDF into pybullet."""

import os

import pybullet


def load_urdf(text: str, client: int, flags: int) -> int:
    """Load a robot with a fixed base, and return the number of the body.

    Pybullet reads files only. The file lies in memory: a killed process leaves no file behind.

    Args:
        text: The URDF.
        client: Pybullet's physics client.
        flags: Flags of ``loadURDF``.
    """
    file = os.memfd_create("cell.urdf")
    try:
        with os.fdopen(os.dup(file), "w", encoding="utf-8") as writer:
            writer.write(text)
        body: int = pybullet.loadURDF(f"/proc/self/fd/{file}", useFixedBase=True, flags=flags, physicsClientId=client)
    finally:
        os.close(file)
    return body
