"""Actions in doubt, after a time-out or a death of the process, and the answers to the questions asked."""

from collections.abc import Callable
from typing import Protocol

from im_core.errors import FOREIGN, ImError, WaitTimeoutError
from im_pnt.execution.events import Answer, Outcome
from im_pnt.execution.firing.rule import DOUBT_CODE, FiringRule
from im_pnt.execution.jobs import Activity, ActivityState, as_failure
from im_pnt.execution.timers import Timers
from im_pnt.model.action import RequestAction

FIRST_PERIOD_S, LAST_PERIOD_S = 0.1, 10.0
"""An action that still runs is asked about again after as long as it is in doubt already, within these limits [s]."""
UNKNOWN = "the outcome of"
"""Begin of the sentence of an action that ends in doubt, and of no other."""
ANSWER_LIMIT_S = 30.0
"""Time that an answer may take [s]; longer than it takes to discover who is asked."""


class Asker(Protocol):
    """Asks, ends and cancels actions for an :class:`Inquiry`."""

    def ask(self, activity: Activity, answered: Callable[[Answer], None]) -> None:
        """Ask for the outcome of an action; the answer may come from any thread."""

    def finish(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        """End an action."""

    def call_off(self, activity: Activity) -> None:
        """Ask an action to end early."""

    def when_released(self, activity: Activity, do: Callable[[], None]) -> None:
        """Do something for an action now, or once the job is not held any more."""


class Inquiry:
    """Watch over deadlines, with questions about actions until the outcome is known.

    Args:
        rule: The marking, and the actions.
        timers: Strike.
        clock: Present time [s].
        asker: Asks.
        answered: Takes answers, from any thread; has :meth:`take_answer` called with them in the loop.
    """

    def __init__(
        self,
        rule: FiringRule,
        timers: Timers,
        clock: Callable[[], float],
        asker: Asker,
        answered: Callable[[Activity, Answer], None],
    ) -> None:
        self._rule, self._timers, self._clock, self._asker, self._answered = rule, timers, clock, asker, answered

    def watch(self, activity: Activity) -> None:
        """Bring an action in doubt at the deadline."""
        if activity.deadline is not None and self._rule.runs(activity) and activity.state is not ActivityState.IN_DOUBT:
            activity.timer = self._timers.at(activity.deadline, lambda: self._strike(activity))

    def renew(self, activity: Activity) -> None:
        """Restart the full time of a request: the requested work was held with the job."""
        timeout = self._rule.transitions[self._rule.number[f"{activity.transition}.start"]].timeout
        asks = isinstance(activity.action, RequestAction) and activity.state is not ActivityState.IN_DOUBT
        if timeout is not None and asks:
            self._timers.cancel(activity.timer)
            activity.deadline = self._clock() + timeout
            self.watch(activity)

    def doubt(self, activity: Activity, why: ImError) -> None:
        """Bring an action in doubt, and ask about the action once the node fires."""
        if not self._rule.runs(activity):
            return
        if activity.state is not ActivityState.IN_DOUBT:
            self._rule.move(activity, ActivityState.IN_DOUBT, why)
        self._timers.cancel(activity.timer)
        activity.timer = self._timers.at(self._clock(), lambda: self._ask(activity))

    def take_answer(self, activity: Activity, answer: Answer) -> None:
        """Take an answer; a late or second one changes nothing."""
        if not self._rule.runs(activity) or activity.state is not ActivityState.IN_DOUBT:
            return
        match answer.outcome:
            case Outcome.DONE:
                self._asker.finish(activity, None, answer.results)
            case Outcome.FAILED:
                what = f"{activity.action} of transition {activity.transition} failed"
                self._asker.finish(activity, answer.error or ImError(what, code="failed"), {})
            case Outcome.RUNNING:
                self._timers.cancel(activity.timer)
                wait = min(LAST_PERIOD_S, max(FIRST_PERIOD_S, self._clock() - activity.doubted))
                activity.timer = self._timers.at(self._clock() + wait, lambda: self._ask(activity))
            case Outcome.UNKNOWN:
                self._asker.finish(activity, self._unknown(activity, answer), {})

    def called_off(self, activity: Activity) -> bool:
        """Return whether only the time limit asked an action to end early: the limit is the cause of the end."""
        job, doubt = activity.lineage.job, activity.doubt
        late = doubt is not None and doubt.code == WaitTimeoutError.default_code
        return late and activity.state is ActivityState.IN_DOUBT and not (job is not None and job.cancelled)

    def _strike(self, activity: Activity) -> None:
        if isinstance(activity.action, RequestAction) and self._rule.is_paused(activity):
            return  # the time begins again when the job is released
        what = f"{activity.action} of transition {activity.transition}"
        self._asker.call_off(activity)
        self.doubt(activity, WaitTimeoutError(what=what, seconds=round(self._clock() - activity.began, 3)))

    def _ask(self, activity: Activity) -> None:
        self._asker.when_released(activity, lambda: self._ask_now(activity))  # to ask may do it again

    def _ask_now(self, activity: Activity) -> None:
        if not self._rule.runs(activity):
            return
        silent = Answer(Outcome.UNKNOWN, asked=f"no answer came in {ANSWER_LIMIT_S:g} s")
        self._timers.cancel(activity.timer)
        activity.timer = self._timers.at(self._clock() + ANSWER_LIMIT_S, lambda: self.take_answer(activity, silent))
        try:
            self._asker.ask(activity, lambda answer: self._answered(activity, answer))
        except FOREIGN as error:  # asking is foreign code, like the action
            failure = as_failure(activity, error)
            self.take_answer(activity, Answer(Outcome.UNKNOWN, asked=f"asking broke: {failure}"))

    def _unknown(self, activity: Activity, answer: Answer) -> ImError:
        now = self._clock()
        return ImError(
            f"{UNKNOWN} {activity.action} of transition {activity.transition} of net {activity.net} is unknown: "
            f"{activity.doubt}; "
            f"asked for {now - activity.doubted:.3g} s: {answer.asked or 'no answer'}",
            code=DOUBT_CODE,
            net=activity.net,
            transition=activity.transition,
            asked=answer.asked,
            seconds=round(now - activity.began, 3),
        )
