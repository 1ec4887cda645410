"""Callbacks of services whose answer is ``success`` and ``message``."""

from collections.abc import Awaitable, Callable
from typing import Any

from im_core.errors import ImError

Serve = Callable[[Any, Any], Awaitable[Any]]


def serving(work: Callable[[Any, Any], Awaitable[str]]) -> Serve:
    """A callback that says what ``work`` says, or why it could not be done.

    Args:
        work: Given request and response; it may fill what else the response has.
    """

    async def serve(request: Any, response: Any) -> Any:
        try:
            response.message = await work(request, response)
            response.success = True
        except ImError as error:
            response.success, response.message = False, error.message
        return response

    return serve
