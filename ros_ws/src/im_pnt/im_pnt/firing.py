"""Two-phase firing of a net (paper, section 6): tokens leave, the action runs, outputs are marked when it confirms."""

import random
from collections.abc import Callable
from typing import Protocol

from im_core.clock import monotonic
from im_core.errors import ImError
from im_pnt.compiled import compile_net
from im_pnt.events import Firing, Observer, Phase
from im_pnt.expand import active_place, expand, input_place
from im_pnt.functions import ActionContext, Functions
from im_pnt.jobs import Activity, Job, Lineage, Request
from im_pnt.ledger import Ledger
from im_pnt.net import Net, RemotePlace, Role, Transition
from im_pnt.tape import ends
from im_pnt.tokens import Tokens

_WAITING_ROLES = (Role.END, Role.FAILED, Role.WITHDRAWN)

Begin = Callable[[Activity, ActionContext], None]
"""Starts an action; must not block and not raise."""


class Outlet(Protocol):
    """Where tokens for other nets and replies to callers go."""

    def send_token(self, net: str, target: RemotePlace, count: int) -> None:
        """Sends tokens to a place of another net."""

    def send_reply(self, request: Request, error: ImError | None, results: dict[str, object]) -> None:
        """Answers a request."""


class FiringRule:
    """The marking of a net, and what firing does to it.

    Args:
        net: The net, as written.
        functions: Registered guards.
        begin: Starts actions.
        outlet: Takes tokens and replies for other nets.
        observer: Is told of firings.
        seed: Seed of the choices among contending transitions.

    Attributes:
        net: The expanded net.
        sequence: Number of the last firing.
        activities: Actions that run, in the order in which they began.
        tokens: The marking.
        ledger: The jobs.
        readers: For each symbol the conflict sets of the transitions that read it.
    """

    def __init__(
        self, net: Net, functions: Functions, begin: Begin, outlet: Outlet, observer: Observer, seed: int
    ) -> None:
        self.net = expand(net)
        self.sequence = 0
        self.activities: dict[Activity, None] = {}
        self._functions, self._begin, self._outlet, self._observer = functions, begin, outlet, observer
        compiled = compile_net(self.net)
        self._transitions = tuple(self.net.transitions.values())
        self._number = {name: index for index, name in enumerate(compiled.transitions)}
        self._place = {name: index for index, name in enumerate(compiled.places)}
        free = [i for i, t in enumerate(self._transitions) if t.role not in _WAITING_ROLES]
        initial = compiled.marking_vector(self.net.initial_marking())
        self.ledger = Ledger()
        self.tokens = Tokens(compiled, free, initial, self.ledger.merge)
        self._enabling = self.tokens.enabling
        self.readers: dict[str, list[int]] = {}
        for index in free:
            symbol = self._transitions[index].symbol
            if symbol:
                self.readers.setdefault(symbol, []).append(self._enabling.conflict_set[index])
        self._stalled: set[int] = set()
        self._dice = random.Random(f"{seed}:{net.name}")

    @property
    def pending(self) -> bool:
        """Whether a decision is due."""
        return self._enabling.pending

    def put(self, place: str, count: int, lineage: Lineage) -> None:
        """Puts tokens on a place from outside."""
        self.tokens.put(self._place[place], count, lineage)

    def write(self, job: Job) -> None:
        """Puts a command on the input tape."""
        self.ledger.add(job)
        self.ledger.tape.write(job)
        for conflict_set in self.readers[job.command.symbol]:
            self._enabling.consider(conflict_set)

    def reconsider(self) -> None:
        """Has the transitions looked at again that only their guards held back."""
        for conflict_set in self._stalled:
            self._enabling.consider(conflict_set)
        self._stalled.clear()

    def step(self) -> bool | None:
        """Takes the next decision.

        Returns:
            Whether a transition fired; None where no decision was due.
        """
        conflict_set = self._enabling.next_decision()
        return None if conflict_set is None else self._decide(conflict_set)

    def withdraw(self, name: str) -> None:
        """Moves the tokens of a data object that has lost its validity."""
        for place in self.net.places.values():
            if place.data_object == name and place.on_invalid:
                index = self._number[f"{place.name}.withdrawn"]
                while self._enabling.tokens[self._place[place.name]]:
                    lineage = self.tokens.take_inputs(index)
                    failure = ImError(f"data object {name} lost its validity", code="data", object=name)
                    if lineage.job is not None:
                        lineage.job.last_failure = failure
                    self._give(index, Lineage(lineage.job, failure))
                    self._tell(self._transitions[index].name, Phase.END, lineage)

    def _decide(self, conflict_set: int) -> bool:
        """Fires one transition of a conflict set; returns whether one might fire."""
        verdicts: dict[tuple[str, int], bool] = {}
        choices: list[int] = []
        stalled = False
        for index in self._enabling.enabled(conflict_set):
            transition = self._transitions[index]
            if transition.symbol and not self.ledger.tape.has(transition.symbol):
                continue
            if transition.guard is not None:
                lineage = self.tokens.peek_inputs(index)
                if transition.symbol:
                    lineage = Lineage(self.ledger.tape.first(transition.symbol), lineage.failure)
                key = (transition.guard.name, id(lineage.job))
                if key not in verdicts:
                    verdicts[key] = self._ask_guard(transition, lineage)
                if verdicts[key] == transition.guard.negated:
                    stalled = True
                    continue
            choices.append(index)
        if not choices:
            if stalled:
                self._stalled.add(conflict_set)
            return False
        best = max(self._transitions[index].priority for index in choices)
        choices = [index for index in choices if self._transitions[index].priority == best]
        self._fire(choices[0] if len(choices) == 1 else self._dice.choice(choices))
        self._enabling.consider(conflict_set)
        return True

    def _ask_guard(self, transition: Transition, lineage: Lineage) -> bool:
        assert transition.guard is not None
        name = transition.guard.name
        context = ActionContext(self.net.name, transition.origin, lineage, progress=self._progress)
        try:
            return bool(self._functions.guards[name](context))
        except Exception as error:  # a guard is foreign code: whatever it raises must not stop the net
            failure = error if isinstance(error, ImError) else ImError(f"guard {name} failed: {error!r}", code="guard")
            if lineage.job is not None:
                lineage.job.last_failure = failure
            self._observer.troubled(self.net.name, f"guard {name} counts as false: {failure}")
            return False

    def _fire(self, index: int) -> None:
        transition = self._transitions[index]
        if transition.role is Role.ACCEPT:
            self.ledger.serving = self.tokens.first(self._place[input_place(transition.origin)]).job
        lineage = self.tokens.take_inputs(index)
        symbol = transition.symbol or ""
        if symbol:
            lineage = Lineage(self.ledger.tape.read(symbol), lineage.failure)
        match transition.role:
            case Role.START:
                self._start(index, lineage, symbol)
                return
            case Role.ACCEPT | Role.FINISH:
                lineage = Lineage(self.ledger.serving, None)
            case Role.FINISH_FAILED:
                job = self.ledger.serving
                lineage = Lineage(job, _failure_of(job, transition, lineage.failure))
            case Role.RETURN:
                self._return(lineage)
        passed_on = lineage.failure if transition.role is Role.FINISH_FAILED else None
        self._give(index, Lineage(lineage.job, passed_on))
        symbol = symbol or (transition.emit[0] if transition.emit else "")
        self._tell(transition.name, Phase.END, lineage, symbol=symbol)
        self._emit(transition, lineage)

    def _return(self, lineage: Lineage) -> None:
        job = lineage.job
        if job is not None and job.request is not None and not job.closed:
            self.ledger.close(job, lineage.failure)
            self._outlet.send_reply(job.request, lineage.failure, job.results)

    def _start(self, index: int, lineage: Lineage, symbol: str) -> None:
        transition = self._transitions[index]
        assert transition.action is not None
        began = monotonic()
        deadline = began + transition.timeout if transition.timeout is not None else None
        end = self._transitions[self._number[f"{transition.origin}.end"]]
        objects = tuple(
            data_object for place in end.outputs if (data_object := self.net.places[place].data_object) is not None
        )
        activity = Activity(
            self.net.name, transition.origin, index, transition.action, lineage, began, deadline, objects
        )
        self.activities[activity] = None
        self.tokens.put(self._place[active_place(transition.origin)], 1, lineage)
        self._tell(transition.origin, Phase.START, lineage, symbol=symbol)
        context = ActionContext(self.net.name, transition.origin, lineage, activity, self._progress)
        self._begin(activity, context)

    def end(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> None:
        """Fires ``t.end`` or ``t.failed`` of an activity.

        Args:
            activity: One of :attr:`activities`.
            error: Why it failed, None if it has confirmed.
            results: Results of a request.
        """
        del self.activities[activity]
        job = activity.lineage.job
        if job is not None and error is not None:
            job.last_failure = error
        if job is not None and error is None:
            job.replies[activity.transition] = results
        index = self._number[f"{activity.transition}.{'failed' if error else 'end'}"]
        self.tokens.take_one(self._place[active_place(activity.transition)], activity.lineage)
        self._give(index, Lineage(job, error))
        lineage = Lineage(job, error)
        transition = self._transitions[index]
        symbol = transition.emit[0] if transition.emit else ""
        duration = monotonic() - activity.began
        phase = Phase.FAILED if error else Phase.END
        self._tell(activity.transition, phase, lineage, symbol=symbol, duration=duration)
        self._emit(transition, lineage)

    def _give(self, index: int, lineage: Lineage) -> None:
        self.tokens.give_outputs(index, lineage)
        for target, count in self._transitions[index].remote_outputs.items():
            self._outlet.send_token(self.net.name, target, count)

    # What is told.

    def _emit(self, transition: Transition, lineage: Lineage) -> None:
        for emitted in transition.emit:
            self._observer.emitted(self.net.name, emitted, lineage)
            job = self.ledger.ended_by(emitted, lineage.job)
            if job is not None:
                done = ends(emitted, job.command.symbol)
                self.ledger.close(job, None if done else _failure_of(job, transition, lineage.failure))

    def _progress(self, lineage: Lineage, text: str, fraction: float) -> None:
        if lineage.job is not None and fraction >= 0.0:
            lineage.job.progress = fraction
        self._observer.progressed(self.net.name, lineage.job, text, fraction)

    def _tell(
        self, transition: str, phase: Phase, lineage: Lineage, *, symbol: str = "", duration: float = 0.0
    ) -> None:
        self.sequence += 1
        job = lineage.job
        message = str(lineage.failure) if phase is not Phase.START and lineage.failure is not None else ""
        self._observer.fired(
            Firing(
                self.net.name,
                transition,
                self.sequence,
                phase,
                symbol,
                job.command.id if job else 0,
                message,
                duration,
                job.progress if job else -1.0,
            )
        )


def _failure_of(job: Job | None, transition: Transition, failure: ImError | None = None) -> ImError:
    """Why a job failed: the failure at hand, the last one of the job, or only where it ended."""
    if failure is not None:
        return failure
    if job is not None and job.last_failure is not None:
        return job.last_failure
    return ImError(f"the net ended it at transition {transition.name}", code="net", transition=transition.name)
