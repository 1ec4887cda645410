"""What the Vision Coordinator decides: whether a light is on, when another look may help, if a look was in vain."""

from collections.abc import Mapping

from im_core.errors import DataError, ImError

#: Spots that were too faint, or too near to something else, may show in a longer exposure.
LOOK_AGAIN_CAUSES = ("too faint", "candidates")


def another_look_may_help(failure: ImError | None) -> bool:
    """Whether a longer exposure may show the spots that a look has missed."""
    causes = failure.facts.get("causes") if failure is not None else None
    if not isinstance(causes, list) or not causes:
        return False
    return all(any(hope in str(cause) for hope in LOOK_AGAIN_CAUSES) for cause in causes)


def require_spot(missed: Mapping[str, str], cameras: int) -> None:
    """One camera that sees the light is enough.

    Args:
        missed: Why a camera does not, by camera.
        cameras: How many looked.

    Raises:
        DataError: None does; its facts say why.
    """
    if len(missed) == cameras:
        named = "; ".join(f"{camera}: {cause}" for camera, cause in missed.items())
        raise DataError(f"no camera sees the light: {named}", code="spot_not_found", causes=[*missed.values()])
