"""``python -m im_coordinators.path_search``: a search of a free path, in a process of its own.

The question comes as JSON on standard input; the answer, or the sentence of an error, is the last line written. The
nodes of the process that asks go on meanwhile.
"""

import json
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from im_cell.robot import Cell, load_cell
from im_coordinators.free_path import FreeSpace, find_path
from im_coordinators.tool import ANY_TILT
from im_coordinators.upright import Upright
from im_core import names
from im_core.errors import ImError
from im_core.processes.process import ChildProcess
from im_mcs.collision import AllowedContact, CollisionScene, Thing
from im_mcs.model import CellModel

#: How long a search may take before it is ended [s]: far longer than its most checks take.
PATIENCE_S = 60.0
#: Exit codes: a path, an error.
FOUND, REFUSED = 0, 1


def search_apart(question: Mapping[str, object]) -> list[list[float]]:
    """Search in a child process; blocks until it ends.

    Args:
        question: JSON data: ``joints``, names of those that move; ``positions``, of all joints by name; ``goals``, of
            those that move, any of them will do; their limits ``lower`` and ``upper``; ``clearance``; ``things``, as
            MCS tells them; ``contacts``, pairs of names that may touch; ``tilt``, how far the ``wrist`` may lean [rad];
            ``seed``.

    Returns:
        Points behind the start, the last one is the goal.

    Raises:
        ImError: No path was found (code ``collision``), the tool leans too far (code ``limit``), or the search failed
            (code ``planning``).
    """
    log = names.run_dir() / "path_search.log"
    child = ChildProcess.of_module("im_coordinators.path_search", log=log, stdin=json.dumps(question))
    if not child.await_end(PATIENCE_S):
        child.stop()
        raise ImError(f"the search of a path did not end within {PATIENCE_S:g} s", code="planning")
    if (code := child.poll()) not in (FOUND, REFUSED):
        raise ImError(f"the search of a path failed: {child.obituary()}", code="planning")
    answer: Any = json.loads(log.read_bytes().splitlines()[-1])
    if code == REFUSED:
        raise ImError(answer["message"], code=answer["code"])
    points: list[list[float]] = answer
    return points


def search(cell: Cell, question: Mapping[str, Any]) -> list[list[float]]:
    """Search; question and answer as of :func:`search_apart`.

    Raises:
        ImError: No path was found (code ``collision``), or the tool leans too far (code ``limit``).
    """
    model = CellModel(cell)
    index = np.array([model.index(joint) for joint in question["joints"]], dtype=np.intp)
    q_all = np.array([question["positions"].get(name, home) for name, home in zip(model.names, cell.home, strict=True)])
    around = CollisionScene(
        tuple(Thing.checked(**each) for each in question["things"]),
        tuple(AllowedContact(first=first, second=second, until_ns=0) for first, second in question["contacts"]),
    )
    lower, upper = np.array(question["lower"]), np.array(question["upper"])
    tilt = question["tilt"]
    upright = None if tilt >= ANY_TILT else Upright(model, question["wrist"], tilt, q_all)
    space = FreeSpace(model, lower, upper, question["clearance"], q_all, index, around, upright)
    found = find_path(space, q_all[index], list(np.array(question["goals"])), question["seed"])
    return [[float(value) for value in point] for point in found.points]


def main(_: Sequence[str] | None = None) -> int:
    """Answer the question on standard input.

    Returns:
        Exit code: :data:`FOUND` or :data:`REFUSED`.
    """
    answer: object
    try:
        answer, code = search(load_cell(), json.load(sys.stdin)), FOUND
    except ImError as error:
        answer, code = {"message": error.message, "code": error.code}, REFUSED
    print(json.dumps(answer), flush=True)
    return code


if __name__ == "__main__":
    sys.exit(main())
