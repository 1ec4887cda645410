"""Context of a function in a separate thread: a copy, written back after the end."""

from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace

from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Lineage


class ApartContext(ActionContext):
    """Context of a function in a separate thread, with a copy of the job, made before the start.

    Args:
        origin: What it would be told in the loop.
        post: Has something called in the loop, soon; from any thread.
    """

    __slots__ = ("_before", "_origin", "_post")

    def __init__(self, origin: ActionContext, post: Callable[[Callable[[], None]], None]) -> None:
        def progress(_: Lineage, text: str, fraction: float) -> None:
            post(lambda: origin.progress(text, fraction))

        job, failure = origin._lineage
        if job is not None:
            command = replace(job.command, arguments=deepcopy(job.command.arguments))
            arguments, results, replies, memory = deepcopy((job.arguments, job.results, job.replies, job.memory))
            job = replace(job, command=command, arguments=arguments, results=results, replies=replies, memory=memory)
        lineage = Lineage(job, failure)
        super().__init__(origin.net, origin.transition, lineage, origin._activity, progress, origin._shared)
        self._origin, self._post = origin, post
        self._before = deepcopy((self.result, self.memory))

    @property
    def cancelled(self) -> bool:
        """Whether the command, the request or the very action was cancelled, also after the start."""
        return self._origin.cancelled

    def on_cancel(self, callback: Callable[[], None]) -> None:
        """Call a function in the loop at the cancellation of the action; soon if already cancelled."""
        self._post(lambda: self._origin.on_cancel(callback))

    def leave(self) -> None:
        """Write the results of the function into the job; in the loop, after the end."""
        own = (self.result, self.memory)
        for before, now, kept in zip(self._before, own, (self._origin.result, self._origin.memory), strict=True):
            for key in before.keys() - now.keys():
                kept.pop(key, None)
            kept.update({key: value for key, value in now.items() if key not in before or before[key] != value})
