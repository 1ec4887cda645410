"""Opening and closing the gripper: the net says it all."""

from pathlib import Path

from im_dispatcher.command import CommandDescription

COMMAND = CommandDescription(net=Path(__file__).parent.parent / "nets/grip.yaml")
