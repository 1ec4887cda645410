"""``im strategies``: experience with strategies, listed and reset."""

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path

import rclpy

from im_core.errors import ImError, NotFoundError
from im_core.names import results_dir
from im_core.output import complain
from im_core.ros.calls import call_blocking
from im_core.ros.guard import GuardedNode
from im_core.ros.run import Spinner
from im_msgs.srv import ControlNet
from im_pnt.execution.strategies import Experience
from im_pnt_node.journal.strategies import read_experience

_WAIT_S = 10.0
_ROW = "{:{}} {:>9} {:>8} {:>7} {:>13}  {}"


def main() -> int:
    """Run ``im strategies``."""
    parser = argparse.ArgumentParser(
        prog="im strategies",
        description="What the machine has learned: each strategy with its counts, the expected probability of success, "
        "and the interval in which that is with a probability of 90 %.",
        epilog="Exit codes: 0 done, 1 nothing was learned about it or a file is damaged, 3 the machine does not run.",
    )
    parser.add_argument(
        "--reset",
        metavar="NAME",
        help="have the running machine forget NET.STRATEGY, in all contexts, or NET.STRATEGY@CONTEXT",
    )
    options = parser.parse_args()
    try:
        learned = {file: read_experience(file) for file in sorted(results_dir().glob("strategies-*.json"))}
        if options.reset is not None:
            return _reset(learned, options.reset)
        print("\n".join(table({name: each for book in learned.values() for name, each in book.items()})))
        return 0
    except ImError as error:
        complain(f"im strategies: {error.message}")
        return 3 if error.code == "timeout" else 1


def table(learned: Mapping[str, Experience]) -> list[str]:
    """Return the lines about all strategies, by name."""
    wide = max(map(len, ("strategy", *learned)))
    lines = [_ROW.format("strategy", wide, "successes", "failures", "success", "90 % within", "last")]
    for name, each in sorted(learned.items()):
        low, high = each.interval()
        within = f"{low:.2f} .. {high:.2f}"
        counts = f"{each.successes:.1f}", f"{each.failures:.1f}"
        lines.append(_ROW.format(name, wide, *counts, f"{each.mean:.2f}", within, each.last))
    return lines if learned else ["nothing was learned yet"]


def _reset(learned: Mapping[Path, Mapping[str, Experience]], name: str) -> int:
    """Have the node of a strategy forget the experience with the strategy.

    Raises:
        NotFoundError: Nothing was learned about it.
        WaitTimeoutError: The node is not there.
    """
    file = next(
        (file for file, book in learned.items() for each in book if name in (each, each.partition("@")[0])), None
    )
    if file is None:
        raise NotFoundError(kind="strategy", name=name, known=[each for book in learned.values() for each in book])
    net, _, strategy = name.partition(".")
    task = file.stem.removeprefix("strategies-")
    rclpy.init()
    try:
        node = GuardedNode("strategies")
        client = node.create_client(ControlNet, f"/{task}/control_net")
        request = ControlNet.Request(net=net, request="forget", argument=strategy)
        with Spinner([node]):
            answer = call_blocking(client, request, _WAIT_S, f"to forget {name}")
        (print if answer.success else complain)(answer.message)
        return 0 if answer.success else 1
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    sys.exit(main())
