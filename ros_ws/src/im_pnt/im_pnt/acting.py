"""The actions of a net: how they begin, are called off, asked about, and end."""

import inspect
from collections.abc import Callable
from typing import TYPE_CHECKING

from im_core.errors import ImError
from im_pnt.action import RequestAction
from im_pnt.choosing import Chooser
from im_pnt.doubt import Answer
from im_pnt.firing import FiringRule
from im_pnt.functions import ActionContext, ActionFunction
from im_pnt.inquiry import Inquiry
from im_pnt.jobs import NO_LINEAGE, Activity, ActivityState, Lineage, as_failure
from im_pnt.net import Role
from im_pnt.timers import Timers

if TYPE_CHECKING:
    from im_pnt.executive import Executive, Runner

CheckObjects = Callable[[tuple[str, ...], Callable[[ImError | None], None]], None]


class Actions:
    """Has the actions of one net done.

    Args:
        executive: The net in execution.
        rule: Its marking.
        chooser: Is told of jobs that have changed, and of outcomes.
        runner: Starts actions.
        timers: Strike.
        clock: Present time [s].
        check_objects: Looks whether data objects are valid; None: they are not checked.

    Attributes:
        inquiry: Watches deadlines, and asks about actions in doubt.
        functions: For each ``t.start`` whose action is a plain function, that function.
    """

    def __init__(
        self,
        executive: "Executive",
        rule: FiringRule,
        chooser: Chooser,
        runner: "Runner",
        timers: Timers,
        clock: Callable[[], float],
        check_objects: CheckObjects | None,
    ) -> None:
        self.inquiry = Inquiry(rule, timers, clock, self, executive.answered)
        self._executive, self._rule, self._chooser, self._runner = executive, rule, chooser, runner
        self._timers, self._clock, self._check_objects = timers, clock, check_objects
        self.functions: dict[int, ActionFunction] = {}
        for index, transition in enumerate(rule.transitions):
            if transition.role is Role.START and transition.action is not None:
                function = runner.direct(transition.action)
                if function is not None:
                    self.functions[index] = function

    def begin(self, index: int, activity: Activity) -> None:
        """Begins the action of a ``t.start`` that has fired; a plain function is called at once."""
        timeout = self._rule.transitions[index].timeout
        if timeout is not None:
            activity.deadline = activity.began + timeout
        job = activity.lineage.job
        if job is not None and job.unwanted and job.last_failure is not None:
            self.cancel(activity, job.last_failure)
        context = self._context(activity)
        if index not in self.functions:
            self._runner.start(self._executive, activity, context)
        else:
            try:
                outcome = self.functions[index](context)
            except Exception as error:  # an action is foreign code: whatever it raises is its failure
                self.finish(activity, as_failure(activity, error), {})
            else:
                if outcome is not None and inspect.isawaitable(outcome):
                    self._runner.watch(self._executive, activity, outcome)
                else:
                    self.finish(activity, None, {})
        self.inquiry.watch(activity)

    def fresh_context(self, index: int) -> ActionContext:
        """Returns what the function of a transition is told where there is no command or request."""
        transition = self._rule.transitions[index]
        return ActionContext(self._rule.net.name, transition.origin, progress=self._rule.teller.progressed)

    def took(self, index: int, context: ActionContext, outcome: object, error: BaseException | None) -> None:
        """Takes over an action whose tokens were taken, and whose function has raised or goes on."""
        activity = self._rule.begin(index, NO_LINEAGE, "")
        if isinstance(error, Exception):
            self.finish(activity, as_failure(activity, error), {})
        elif error is not None:
            raise error
        elif inspect.isawaitable(outcome):
            context.bind(activity)
            self._runner.watch(self._executive, activity, outcome)

    def cancel(self, activity: Activity, error: ImError) -> None:
        """Asks an action to end early, and shows it in the marking while it winds down."""
        if activity.state is ActivityState.ACTIVE:
            self._rule.move(activity, ActivityState.CANCELLING, error)
        self.call_off(activity)

    def call_off(self, activity: Activity) -> None:
        """Asks an action to end early."""
        for error in activity.cancel():
            self._rule.teller.troubled(f"cancelling {activity.action} broke: {error!r}")

    def ask(self, activity: Activity, answered: Callable[[Answer], None]) -> None:
        """Asks what became of an action."""
        self._runner.ask(self._executive, activity, self._context(activity), answered)

    def finish(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        """Ends an action; before it counts as a success, its data objects are looked at."""
        if error is None and activity.objects and self._check_objects is not None and not activity.checked:
            activity.checked = True
            self._check_objects(activity.objects, lambda invalid: self._executive.ended(activity, invalid, results))
            return
        self._timers.cancel(activity.timer)
        counts = activity.state is ActivityState.ACTIVE
        failure = self._rule.end(activity, error, results)
        if counts:
            self._learn(activity, failure is None)
        if activity.lineage.job is not None:
            self._chooser.wake_job(activity.lineage.job)

    def resume(self) -> None:
        """Goes on with the actions that ran when the process died."""
        why = ImError("the process that ran it has died and come back", code="restarted")
        for activity in list(self._rule.activities.values()):
            index = self._rule.number[f"{activity.transition}.start"]
            if activity.reply is not None:
                self.finish(activity, *activity.reply)
            elif not isinstance(activity.action, RequestAction) or activity.state is ActivityState.IN_DOUBT:
                self.inquiry.doubt(activity, why)
            elif self._runner.waits(activity):
                timeout = self._rule.transitions[index].timeout
                activity.deadline = None if timeout is None else self._clock() + timeout
                self.inquiry.watch(activity)
            else:
                self.begin(index, activity)

    def _learn(self, activity: Activity, success: bool) -> None:
        strategy = self._rule.transitions[self._rule.number[f"{activity.transition}.start"]].strategy
        if strategy is None:
            return
        try:
            self._chooser.book.outcome(activity.net, activity.transition, strategy, success)
        except OSError as error:
            self._rule.teller.troubled(f"what was learned about {activity.transition} cannot be saved: {error}")

    def _context(self, activity: Activity) -> ActionContext:
        lineage: Lineage = activity.lineage
        return ActionContext(activity.net, activity.transition, lineage, activity, self._rule.teller.progressed)
