"""Begin and end of actions in a re-run."""

from collections.abc import Awaitable, Callable, Mapping
from copy import deepcopy
from typing import Any, Protocol

from im_core.errors import DataError, ImError
from im_pnt.execution.actions import ActionOwner
from im_pnt.execution.executor import Executor
from im_pnt.execution.functions import ActionContext, Functions
from im_pnt.execution.jobs import Activity, Reply
from im_pnt.execution.journal_entries import ActivityEnded, take_data
from im_pnt.execution.runner import Ask, FunctionRunner, Perform
from im_pnt.execution.values import Objects
from im_pnt.model.action import FunctionAction
from im_pnt_node.rerun.progress import RerunProgress
from im_pnt_node.rerun.script import Reading, Script, ScriptHost

ENDED = "its recorded end"


class ActionsAgain(Protocol):
    """Repetition of actions on other tasks; made for each incarnation of a node."""

    def performers(
        self, script: Script, functions: Functions, keep: Callable[[Activity], None]
    ) -> tuple[Mapping[type, Perform], Mapping[type, Ask]]:
        """Return the performer of each kind of action, and the question after a doubt.

        Args:
            script: Gives what was read.
            functions: Builders and handlers.
            keep: Has kept what the builder of an action has left in its job.
        """

    def objects(self, host: ScriptHost, spawn: Callable[..., None], known: Callable[[], None]) -> Objects:
        """Return the data objects of expressions."""

    def heard(self, kind: str, data: str) -> object:
        """Return a recorded message."""


class RerunExecutor(Executor):
    """Net of a re-run: actions end at the recorded place.

    Attributes:
        completions: How actions have ended that the recording has not come to yet, by their numbers.
    """

    completions: dict[int, Reply]

    def ended(self, activity: Activity, error: ImError | None, results: dict[str, object] | None = None) -> None:
        """Keep the end of an action."""
        self.completions[activity.number] = Reply(error, results or {})


class NotDoneAgain:
    """Stand-in for actions named as ``module:function``: a repeat may move something; recorded results are used."""

    def __init__(self, progress: RerunProgress) -> None:
        self._progress = progress
        self.known: set[str] = set()

    def functions(self, *, others_made: bool) -> dict[str, Callable[..., object]]:
        """Return the stand-ins for actions of nets named ``module:function``.

        Args:
            others_made: Whether the node says what makes those that it has registered.

        Raises:
            DataError: It does not, and a net names one.
        """
        found: dict[str, Callable[..., object]] = {}
        for net in self._progress.nets.values():
            for transition in net.transitions.values():
                if not isinstance(action := transition.action, FunctionAction):
                    continue
                if action.is_imported:
                    found[action.function] = forever
                elif not others_made:
                    text = f"net {net.name} calls {action.function}; {self._progress.node} does not say by made_by"
                    raise DataError(f"{text} what makes its functions", net=net.name)
        self.known |= found.keys()
        return found

    def leave(self, activity: Activity, ended: ActivityEnded) -> None:
        """Write the recorded results of an action without repetition into the job."""
        job = activity.lineage.job
        if ended.data is not None and job is not None:
            before = deepcopy(job.recorded)
            take_data(job, ended.data)
            job.recorded = before  # what has changed since is told again


async def forever(_: ActionContext) -> None:
    """Wait, as an action without repetition: the end is the recorded one."""
    await Reading(ENDED)


class Labelled(FunctionRunner):
    """Begins actions, and tells the script which."""

    def __init__(self, script: Script, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._script = script

    def start(self, owner: ActionOwner, activity: Activity, context: ActionContext) -> None:
        """Begin an action."""
        self._script.label = activity
        super().start(owner, activity, context)

    def watch(self, owner: ActionOwner, activity: Activity, work: Awaitable[object]) -> None:
        """Wait for the remaining work of a function."""
        self._script.label = activity
        super().watch(owner, activity, work)
