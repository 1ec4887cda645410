"""Fields of shared memory, copied all at once, compiled."""

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

class Fields:
    """Some fields of shared memory, in a fixed order.

    Args:
        views: The fields; numbers have shape ().

    Raises:
        ValueError: One is no array in a row.
    """

    def __init__(self, views: Sequence[NDArray[Any]]) -> None: ...
    def put(self, values: tuple[Any, ...]) -> None:
        """Write all fields.

        Raises:
            ValueError: The values are not as many, or of another shape.
        """

    def get(self) -> tuple[Any, ...]:
        """Return copies of all fields; integers of shape () as numbers."""
