"""A runner that has the journal written before an action begins."""

from collections.abc import Awaitable, Callable

from im_pnt.action import Action, RequestAction
from im_pnt.executive import Executive, Runner
from im_pnt.functions import ActionContext, ActionFunction
from im_pnt.jobs import Activity
from im_pnt.journal.errors import JournalError


class GuardedRunner:
    """Has the journal written, then the action begun.

    A request leaves with the next commit anyway; not to write it apart keeps it in one batch with its firing.

    Args:
        runner: Does the rest.
        write: Writes the journal; raises where it cannot.
    """

    def __init__(self, runner: Runner, write: Callable[[], None]) -> None:
        self._runner, self._write = runner, write
        self.watch, self.waits, self.ask = runner.watch, runner.waits, runner.ask

    def start(self, executive: Executive, activity: Activity, context: ActionContext) -> None:
        """Starts an action; one that cannot be journalled fails."""
        if not isinstance(activity.action, RequestAction):
            try:
                self._write()
            except JournalError as error:
                executive.ended(activity, error)
                return
        self._runner.start(executive, activity, context)

    def direct(self, action: Action) -> ActionFunction | None:
        """Returns the function that does an action when it is called."""
        function = self._runner.direct(action)
        if function is None:
            return None

        def guarded(context: ActionContext) -> object | Awaitable[object]:
            self._write()
            return function(context)

        return guarded
