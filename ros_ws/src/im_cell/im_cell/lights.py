"""State of the wrist lights, as reported by the testbed."""

from im_cell.robot import Cell
from im_core.errors import DataError
from im_core.text.bounded_json import read_json


def lights_told(text: str, cell: Cell) -> dict[str, bool]:
    """Return the state of each light, from the text received on ``/testbed/lights``.

    Raises:
        DataError: It is no such object, or not of the lights of this cell: the testbed has not said it.
    """
    told = read_json(dict[str, bool], text, "the state of the lights")
    if set(told) != set(cell.light_names):
        raise DataError(f"the state of the lights names {len(told)} lights, not just {' and '.join(cell.light_names)}")
    return told
