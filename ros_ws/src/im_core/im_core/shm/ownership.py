"""Names of shared memory and of semaphores that another user of the host has taken."""

from collections.abc import Iterator
from contextlib import contextmanager

import posix_ipc

from im_core.errors import LinkError


@contextmanager
def own_names(what: str, name: str) -> Iterator[None]:
    """Says of a name whose it is, where that is not this user's.

    Args:
        what: What is used within, e.g. ``semaphore``.
        name: Its name.

    Raises:
        LinkError: It is another user's.
    """
    try:
        yield
    except (posix_ipc.PermissionsError, PermissionError) as error:
        raise LinkError(
            f"{what} '{name}' belongs to another user of this host: "
            "his machine and yours need different values of ROS_DOMAIN_ID",
            name=name,
        ) from error
