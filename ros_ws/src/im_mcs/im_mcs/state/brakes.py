"""What the testbed says of power and brakes, in sentences."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from im_core.errors import StateError
from im_mcs.state.table import Event
from im_mcs.testbed.driver import Measured


def named(joints: Sequence[str], ranks: NDArray[np.intp]) -> str:
    """Names of the joints with these ranks."""
    return ", ".join(joints[rank] for rank in ranks)


def require_secured(event: Event, measured: Measured, joints: Sequence[str]) -> None:
    """Whether power is off and every brake holds.

    Args:
        event: What is asked for.
        measured: What the slots say.
        joints: Names of all joints.

    Raises:
        StateError: Not so; joints with an open brake are named.
    """
    if measured.power:
        raise StateError(f"{event.value} is refused: the testbed still reports power on", request=event.value)
    if not measured.brakes.all():
        which = named(joints, np.flatnonzero(~measured.brakes))
        sentence = f"{event.value} is refused: the testbed reports the brake open of {which}"
        raise StateError(sentence, request=event.value, joints=which)
