"""A node whose places stand for data objects, for tests that kill it: ``python -m support.keeper FOLDER``."""

import sys
from pathlib import Path

from rclpy.parameter import Parameter
from std_msgs.msg import String

from im_core.ros.run import main
from im_pnt_analysis import verify_to_load
from im_pnt_node.ros.node import PntNode

#: The objects for which a place of the net stands.
OBJECTS = ("a", "b", "c")

_OF_ONE = """
  wanted_{name}: {{tokens: 1}}
  there_{name}: {{capacity: 1, data_object: {{name: {name}, scope: global}}, on_invalid: [wanted_{name}]}}
"""
_MAKE = """
  make_{name}: {{in: wanted_{name}, out: there_{name}, action: make, on_failure: wanted_{name}}}
  leave_{name}: {{in: there_{name}, out: wanted_{name}, guard: never}}
"""

#: Whatever has lost its validity is made again, whatever becomes of the action that does.
NET = (
    "net: keeper\nplaces:"
    + "".join(_OF_ONE.format(name=name) for name in OBJECTS)
    + "transitions:"
    + "".join(_MAKE.format(name=name) for name in OBJECTS)
)


class Keeper(PntNode):
    """Makes each object that is not there, and keeps a journal.

    Args:
        folder: Of its net and journal.
    """

    def __init__(self, folder: Path) -> None:
        file = folder / "keeper.yaml"
        file.write_text(NET)
        settings = {"standalone": True, "journal_dir": str(folder / "journal")}
        parameters = [Parameter(name, value=value) for name, value in settings.items()]
        guards = {"never": lambda ctx: False}
        functions = {"make": self.make}
        super().__init__("keeper", [file], functions, guards, verifier=verify_to_load, parameter_overrides=parameters)

    async def make(self, ctx) -> None:
        """Stores an object."""
        name = ctx.transition.removeprefix("make_")
        await self.dom.put(name, String(data="made"), place=f"keeper.there_{name}")


if __name__ == "__main__":
    sys.exit(main(lambda: Keeper(Path(sys.argv[1])), args=["--ros-args"]))
