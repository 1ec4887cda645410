"""Actions of a net: begin, cancellation, questions, and end."""

import inspect
from collections.abc import Awaitable, Callable
from typing import Protocol

from im_core.errors import FOREIGN, ImError
from im_pnt.execution.conflicts import ConflictResolution
from im_pnt.execution.doubt import Inquiry
from im_pnt.execution.events import Answer
from im_pnt.execution.firing.rule import DOUBT_CODE, FiringRule, is_interrupted
from im_pnt.execution.functions import ActionContext, ActionFunction
from im_pnt.execution.jobs import Activity, ActivityState, Lineage, as_failure
from im_pnt.execution.journal_entries import Record
from im_pnt.execution.timers import Timers
from im_pnt.model.action import Action, AwaitAction, RequestAction
from im_pnt.model.net import Role

CheckObjects = Callable[[tuple[str, ...], Callable[[ImError | None], None]], None]


class ActionOwner(Protocol):
    """Net in execution, as seen by the runners of the actions."""

    def runs(self, activity: Activity) -> bool:
        """Return whether an action has not ended."""

    @property
    def record(self) -> Record | None:
        """Receiver of each entry before the effect; None: no journal."""

    def ended(self, activity: Activity, error: ImError | None, results: dict[str, object] | None = None) -> None:
        """Report the confirmation of an action, or the failure with an error; from any thread."""

    def answered(self, activity: Activity, answer: Answer) -> None:
        """Report the outcome of an action in doubt; from any thread."""

    def built(self, activity: Activity) -> None:
        """Record the notes of a request's builder in the job, after the return.

        Raises:
            NetError: A journal cannot keep it.
        """


class Runner(Protocol):
    """Runner of actions; calls :meth:`ActionOwner.ended` after the confirmation or failure."""

    def start(self, owner: ActionOwner, activity: Activity, context: ActionContext) -> None:
        """Start an action; must not block and not raise."""

    def direct(self, action: Action) -> ActionFunction | None:
        """Return the function of an action for a direct call, None where the action must be started."""

    def watch(self, owner: ActionOwner, activity: Activity, work: Awaitable[object]) -> None:
        """Wait for the remaining work of a directly called function."""

    def waits(self, activity: Activity) -> bool:
        """Return whether a sent request still awaits the reply."""

    def ask(
        self, owner: ActionOwner, activity: Activity, context: ActionContext, answered: Callable[[Answer], None]
    ) -> None:
        """Ask for the outcome of an action in doubt; the answer may come from any thread."""


class Actions:
    """Has the actions of one net done.

    Args:
        owner: The net in execution.
        rule: Its marking.
        conflicts: Is told of jobs that have changed, and of outcomes.
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
        owner: ActionOwner,
        rule: FiringRule,
        conflicts: ConflictResolution,
        runner: Runner,
        timers: Timers,
        clock: Callable[[], float],
        check_objects: CheckObjects | None,
    ) -> None:
        self.inquiry = Inquiry(rule, timers, clock, self, owner.answered)
        self._owner, self._rule, self._conflicts, self._runner = owner, rule, conflicts, runner
        self._timers, self._clock, self._check_objects = timers, clock, check_objects
        self._strategies = {t.origin: i for i, t in enumerate(rule.transitions) if t.role is Role.START and t.strategy}
        self.functions: dict[int, ActionFunction] = {}
        self._deferred: dict[int, Callable[[], None]] = {}
        self._says = {t.origin: t.says for t in rule.transitions if t.says}
        for index, transition in enumerate(rule.transitions):
            if transition.role is Role.START and transition.action is not None:
                function = runner.direct(transition.action)
                if function is not None:
                    self.functions[index] = function

    def begin(self, index: int, activity: Activity) -> None:
        """Begin the action of a fired ``t.start``; a plain function is called at once."""
        timeout = self._rule.transitions[index].timeout
        if timeout is not None:
            activity.deadline = activity.began + timeout
        job = activity.lineage.job
        if job is not None and job.unwanted and (why := job.last_failure) is not None:
            self.cancel(activity, why)
            self.finish(activity, why, {})
            return
        context, function = self._context(activity), self.functions.get(index)
        if activity.transition in self._says and self._is_told(activity, lambda: self._progressed(activity)):
            self._progressed(activity)
        if function is None:
            self._rule.notifier.flush()
            self._runner.start(self._owner, activity, context)
        else:
            try:
                outcome = function(context)
            except FOREIGN as error:  # an action is foreign code: whatever it raises is its failure
                self.finish(activity, as_failure(activity, error), {})
            else:
                if outcome is not None and inspect.isawaitable(outcome):
                    self._runner.watch(self._owner, activity, outcome)
                else:
                    self.finish(activity, None, {})
        if timeout is not None:
            self.inquiry.watch(activity)

    def cancel(self, activity: Activity, error: ImError) -> None:
        """Ask an action to end early, and show the winding down in the marking."""
        if activity.state is ActivityState.ACTIVE:
            self._rule.move(activity, ActivityState.CANCELLING, error)
        self.call_off(activity)

    def abandon(self, activity: Activity, error: ImError) -> None:
        """Call off the action of an abandoned job; nothing awaits its end."""
        self._timers.cancel(activity.timer)
        self._deferred.pop(activity.number, None)
        for tell in activity.on_abandon:
            tell(error)
        self.call_off(activity)

    def call_off(self, activity: Activity) -> None:
        """Ask an action to end early."""
        for error in activity.cancel():
            self._rule.notifier.troubled(f"cancelling {activity.action} broke: {error!r}")

    def ask(self, activity: Activity, answered: Callable[[Answer], None]) -> None:
        """Ask for the outcome of an action."""
        self._runner.ask(self._owner, activity, self._context(activity), answered)

    def finish(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        """End an action; the returned and stored values and the data objects come before success."""
        self._rule.values.stale()
        called_off = self.inquiry.called_off(activity) or is_interrupted(activity)
        if error is not None and error.code == "cancelled" and called_off:
            error = activity.doubt
        if error is None and not activity.concluded and activity.transition in self._rule.values.effective:
            activity.concluded = True
            self._conclude(activity, results)
            return
        if error is None and activity.objects and self._check_objects is not None and not activity.checked:
            activity.checked = True
            self._check_objects(activity.objects, lambda invalid: self._owner.ended(activity, invalid, results))
            return
        self._timers.cancel(activity.timer)
        self._deferred.pop(activity.number, None)
        learns = activity.transition in self._strategies and activity.state is ActivityState.ACTIVE
        if error is not None and error.code not in ("cancelled", DOUBT_CODE) and activity.transition in self._says:
            if not self._is_told(activity, lambda: self._owner.ended(activity, error, results)):
                return
            error = ImError.restored(error.code, f"could not {activity.told}: {error.message}", error.facts)
        failure = self._rule.end_action(activity, error, results)
        if learns and (failure is None or failure.code != "link"):  # a dead server says nothing of the strategy
            self._learn(activity, failure)
        if activity.lineage.job is not None:
            self._conflicts.wake_job(activity.lineage.job)

    def _conclude(self, activity: Activity, results: dict[str, object]) -> None:
        """Return and store the values of a well ended action's transition, and end the action then."""
        context, at_once = self._context(activity), True

        def done(error: ImError | None) -> None:
            if at_once:
                self.finish(activity, error, results)
            else:
                self._owner.ended(activity, error, results)

        self._rule.values.conclude(context, context.result, results, done)
        at_once = False

    def resume(self) -> None:
        """Go on with the actions running at the death of the process; others are reached once the node fires."""
        why = ImError("the process of the action died and was restarted", code="restarted")
        for activity in list(self._rule.activities.values()):
            index = self._rule.number[f"{activity.transition}.start"]
            if activity.reply is not None:
                self.finish(activity, *activity.reply)
            elif isinstance(activity.action, AwaitAction) and activity.state is ActivityState.ACTIVE:
                self._begin_soon(index, activity)  # it has no effect, and is awaited again
            elif not isinstance(activity.action, RequestAction) or activity.state is ActivityState.IN_DOUBT:
                self.inquiry.doubt(activity, why)
            elif self._runner.waits(activity):
                timeout = self._rule.transitions[index].timeout
                activity.deadline = None if timeout is None else self._clock() + timeout
                self.inquiry.watch(activity)
            else:
                self._begin_soon(index, activity)

    def when_released(self, activity: Activity, do: Callable[[], None]) -> None:
        """Do something for an action now, or once the job is not held any more."""
        if self._rule.is_paused(activity):
            self._deferred[activity.number] = do
        else:
            do()

    def release(self, activity: Activity) -> None:
        """Go on with an action after the end of the job's hold, and with the action's requests to another net."""
        if (do := self._deferred.pop(activity.number, None)) is not None:
            do()
        self.inquiry.renew(activity)
        for tell in activity.on_release:
            tell()

    def _begin_soon(self, index: int, activity: Activity) -> None:
        def begin() -> None:
            self.when_released(activity, lambda: self.begin(index, activity))

        activity.timer = self._timers.at(self._clock(), begin)

    def _is_told(self, activity: Activity, later: Callable[[], None]) -> bool:
        """Whether the text about an action is known; else read the data objects in it, and call back once it is."""
        at_once = True

        def told(text: str) -> None:
            activity.told = text
            if not at_once:
                later()

        if activity.told is None:
            self._rule.values.tell(self._says[activity.transition], self._context(activity), told)
        at_once = False
        return activity.told is not None

    def _progressed(self, activity: Activity) -> None:
        if self._rule.runs(activity):
            self._rule.notifier.progressed(activity.lineage, activity.told or "", -1.0)

    def _learn(self, activity: Activity, failure: ImError | None) -> None:
        try:
            self._conflicts.learn(self._strategies[activity.transition], self._context(activity), failure)
        except (OSError, ImError) as error:
            self._rule.notifier.troubled(f"the learned counts of {activity.transition} cannot be saved: {error}")

    def _context(self, activity: Activity) -> ActionContext:
        lineage: Lineage = activity.lineage
        rule, progress = self._rule, self._rule.notifier.progressed
        return ActionContext(
            activity.net,
            activity.transition,
            lineage,
            activity,
            progress,
            shared=rule.shared_objects,
            values=rule.values,
        )
