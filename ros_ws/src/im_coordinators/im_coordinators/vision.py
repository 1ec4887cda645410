"""Decisions of the Vision Coordinator: success of a look."""

from collections.abc import Mapping

from im_core.errors import DataError

#: Spots that were too faint, or too near to something else, may show in a longer exposure.
LOOK_AGAIN_CAUSES = ("too faint", "candidates")

#: Codes of the failure to see the light: where a longer exposure may show it, and where nothing can.
TOO_FAINT, NOT_FOUND = "spot_too_faint", "spot_not_found"


def require_spot(missed: Mapping[str, str], cameras: int, what: str = "the light") -> None:
    """Check for a spot: one camera with the light in view is enough.

    Raises:
        DataError: None does, code :data:`TOO_FAINT` or :data:`NOT_FOUND`; its facts say why.
    """
    if len(missed) == cameras:
        named = "; ".join(f"{camera}: {cause}" for camera, cause in missed.items())
        hope = missed and all(any(hope in cause for hope in LOOK_AGAIN_CAUSES) for cause in missed.values())
        code = TOO_FAINT if hope else NOT_FOUND
        raise DataError(f"no camera sees {what}: {named}", code=code, causes=[*missed.values()])
