"""Establishments for a command (power, a light), lost when the task in charge gets a new incarnation."""

from im_core.errors import StateError

BEGUN_ANEW = "begun_anew"
"""Code of the failure; nets that can establish it again, and do again what needs it, look for that."""


def lost(task: str, what: str, name: str) -> StateError:
    """Return the error for going on with an establishment lost meanwhile.

    Args:
        task: Who kept it.
        what: What it was, such as ``powered``.
        name: Of what, such as ``left``.
    """
    text = f"{task} has begun anew since {name} was {what} for this command, and knows nothing of that"
    return StateError(text, code=BEGUN_ANEW, task=task, established=f"{what}/{name}")
