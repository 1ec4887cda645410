"""Errors of the machine to and from ``im_msgs/msg/Status``."""

import json

from diagnostic_msgs.msg import KeyValue

from im_core.errors import ImError
from im_msgs.msg import Status

OK = "ok"


def ok_status(message: str = "") -> Status:
    """Return the status of a success."""
    return Status(code=OK, message=message)


def to_status(error: ImError) -> Status:
    """Convert an error to a message."""
    facts = [KeyValue(key=key, value=json.dumps(value, default=str)) for key, value in error.facts.items()]
    return Status(code=error.code, message=error.message, facts=facts)


def status_to_error(status: Status) -> ImError:
    """Convert a message to an error."""
    facts: dict[str, object] = {}
    for fact in status.facts:
        try:
            facts[fact.key] = json.loads(fact.value)
        except (ValueError, RecursionError):
            facts[fact.key] = fact.value
    code = status.code or ImError.default_code
    return ImError.restored(code, status.message or f"it failed ({code}), and no reason was given", facts)
