"""Two-phase firing of a net (paper, section 6): tokens leave, the action runs, the confirmation marks the outputs.

What is here is deterministic: it is done again, in the same order, when a journal is replayed. What decides, waits or
calls foreign code is elsewhere.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import JobUpdate
from im_pnt.execution.jobs import (
    NO_COMMAND,
    NO_LINEAGE,
    Activity,
    ActivityState,
    Job,
    Ledger,
    Lineage,
    Request,
    ends,
    object_name,
    scope_of,
)
from im_pnt.execution.journal_entries import (
    EndFired,
    MessageBuilt,
    PhaseFired,
    Record,
    TransitionFired,
    changed_data,
    plain_dict,
    recorded_data,
)
from im_pnt.execution.marking import Tokens
from im_pnt.execution.notification import Departure, Notifier, Observer, Outlet, Phase, failure_of
from im_pnt.execution.values import NetValues, Objects
from im_pnt.model.action import AwaitAction, RequestAction
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import active_place, cancelling_place, doubt_place, expand, input_place
from im_pnt.model.net import Net, ObjectScope, ReadFor, Role, Transition
from im_pnt.model.resources import given_back, resource_places

ADDRESS = "command"
"""Argument of a word to a command: the number of that command; without it, it is for whichever asks first."""
DOUBT_CODE = "in_doubt"
"""Code of the error of an action of which nobody can tell what became."""
ABANDONED_CODE = "abandoned"
"""Code of the error of a job that ends at once, though nothing fires."""
INTERRUPTED_CODE = "interrupted"
"""Code of the error of an action that a transition has asked to end early."""
_WAITING_ROLES = (Role.END, Role.FAILED, Role.CANCEL, Role.LOST, Role.GIVEN_UP, Role.WITHDRAWN)
_PHASE_PLACES = {
    ActivityState.ACTIVE: active_place,
    ActivityState.CANCELLING: cancelling_place,
    ActivityState.IN_DOUBT: doubt_place,
}


# An attribute of an enumeration is looked up by Python code (before Python 3.12): what each firing needs has a name.
_ACTIVE, _PLAIN, _START = ActivityState.ACTIVE, Role.PLAIN, Role.START
_STARTED, _ENDED = Phase.START, Phase.END


class _Phases(NamedTuple):
    """Parts of a transition with an action in the expanded net; found once, not at each firing.

    Attributes:
        start: ``t.start``.
        active: Number of ``t.active``.
        places: For each state of the action the number of the place that is marked then.
        objects: Data objects that the outputs of ``t.end`` stand for, as the net names them.
    """

    start: Transition
    active: int
    places: Mapping[ActivityState, int]
    objects: tuple[str, ...]


class FiringRule:
    """Marking and jobs of a net, with the effects of firings on both.

    Args:
        net: The net, as written.
        outlet: Takes tokens and replies for other nets.
        observer: Is told of firings.
        clock: Present time [s].
        objects: The data objects that its expressions read and store; None: there are none here.

    Attributes:
        net: The expanded net.
        transitions: Its transitions, by number.
        number: Number of each transition.
        activities: Actions that run, by their numbers, in the order in which they began.
        tokens: The marking.
        enabling: What it enables.
        ledger: The jobs.
        readers: For each symbol the transitions that read it.
        notifier: Tells of firings.
        outlet: Takes tokens and replies for other nets.
        clock: Present time [s].
        record: Takes what happens, before it does; None: no journal.
        values: What its expressions are; not for what is done again when a journal is replayed.
        expires: For each symbol that does not wait for ever, how long it does [s].
        choosy: Transitions that tokens alone do not enable: it matters whose they are.
        cancelling: For each transition that asks an action to end early, the transition of that action.
        begins: Transitions that begin a command where they read a symbol with tokens of nobody.
        held: Numbers of the commands for which nothing is begun, with their scopes as far as these are known; of a
            visit, and of a request that was paused with its caller, the number here, negative.
        replaying: Whether what an entry of a journal tells is done again.
        shared_objects: Data objects that places declare to be global.
    """

    def __init__(
        self,
        net: Net,
        outlet: Outlet,
        observer: Observer,
        clock: Callable[[], float],
        objects: Objects | None = None,
    ) -> None:
        self.net = expand(net)
        self.record: Record | None = None
        self.values = NetValues(net, objects)
        self.outlet, self.clock = outlet, clock
        compiled = compile_net(self.net)
        self.transitions = tuple(self.net.transitions.values())
        self.number = {name: index for index, name in enumerate(compiled.transitions)}
        self.place = {name: index for index, name in enumerate(compiled.places)}
        free = [i for i, t in enumerate(self.transitions) if t.role not in _WAITING_ROLES]
        self.ledger = Ledger()
        initial = compiled.marking_vector(self.net.initial_marking())
        declared = {place.name for place in self.net.places.values() if place.resource}
        self.cancelling = {i: t.cancels for i, t in enumerate(self.transitions) if t.cancels is not None}
        phases = {phase(name) for name in self.cancelling.values() for phase in (active_place, cancelling_place)}
        resources = {self.place[name] for name in declared | resource_places(net) | phases}
        self.tokens = Tokens(compiled, free, initial, resources)
        self.enabling = self.tokens.enabling
        self._phases = {t.origin: self._phases_of(t) for t in self.transitions if t.role is Role.START}
        self.activities: dict[int, Activity] = {}
        self.notifier = Notifier(net.name, observer)
        self.readers: dict[str, list[int]] = {}
        for index in free:
            symbol = self.transitions[index].symbol
            if symbol:
                self.readers.setdefault(symbol, []).append(index)
        ends_service = (Role.FINISH, Role.FINISH_FAILED)
        self._finishing = frozenset(i for i, t in enumerate(self.transitions) if t.role in ends_service)
        self._withdrawing = frozenset(i for i, t in enumerate(self.transitions) if t.role is Role.WITHDRAWN)
        self._to_commands = frozenset(i for i, t in enumerate(self.transitions) if t.symbol_of is ReadFor.COMMAND)
        self.choosy = self.tokens.choosy | self._finishing | self._to_commands | self.cancelling.keys()
        beginning = (i for i in free if self.transitions[i].symbol and self.transitions[i].symbol_of is None)
        self.begins = frozenset(beginning)
        self._narrowed = self._finishing | self._to_commands | self.begins | self.cancelling.keys()
        self.held: dict[int, str] = {}
        self.replaying = False
        reading = [t for t in self.transitions if t.symbol is not None]
        self.expires = {t.symbol: t.symbol_expires for t in reading if t.symbol and t.symbol_expires is not None}
        self._words = frozenset(t.symbol for t in reading if t.symbol_of is ReadFor.COMMAND)
        shown = [place for place in self.net.places.values() if place.object_scope is ObjectScope.GLOBAL]
        self.shared_objects = frozenset(place.data_object for place in shown if place.data_object)
        self._withdrawable = [
            (place.name, place.data_object)
            for place in self.net.places.values()
            if place.data_object is not None and place.on_invalid
        ]
        emitted = {each for transition in self.transitions for each in transition.emit}
        self._answered = {s for s in self.readers if any(ends(each, s) is not None for each in emitted)}

    def _phases_of(self, start: Transition) -> _Phases:
        places = {state: self.place[name(start.origin)] for state, name in _PHASE_PLACES.items()}
        outputs = (self.net.places[name] for name in self.net.transitions[f"{start.origin}.end"].outputs)
        named = tuple(place.data_object for place in outputs if place.data_object is not None)
        return _Phases(start, places[ActivityState.ACTIVE], places, named)

    # What comes from outside.

    def mark_place(self, place: str, count: int, lineage: Lineage) -> None:
        """Put tokens on a place from outside."""
        if lineage is NO_LINEAGE and not self.tokens.queues:
            self.enabling.add_tokens(self.place[place], count)
        else:
            self.tokens.put_tokens(self.place[place], count, lineage)

    def write(self, job: Job) -> None:
        """Put a job on the input tape."""
        self.ledger.add(job)
        address = job.arguments.get(ADDRESS)
        if job.symbol in self._words and address is not None and not self._under_way(address):
            text = f"{job.symbol} is for command {address}, which is not under way"
            self.close(job, NetError(text, symbol=job.symbol, command=address))
            return
        self.ledger.tape.write(job)
        self.consider_readers(job.symbol)

    def take_request(self, request: Request) -> None:
        """Take a request: to the place I of the service, or, with a symbol, to the input tape."""
        job = Job(request.command, request.arguments, request)
        if request.service in self.net.services:
            self.ledger.add(job)
            self.mark_place(input_place(request.service), 1, Lineage(job, None))
        elif request.service in self.readers:
            self.write(job)
        else:
            self.ledger.add(job)
            text = f"net {self.net.name} offers no service and reads no symbol {request.service}"
            self.close(job, NetError(text, net=self.net.name, service=request.service))

    def _departure(self, job: Job | None, net: str, count: int) -> Departure | None:
        """Return the departure of tokens to another net, None without a job; the job is away there."""
        if job is None:
            return None
        job.away[net] = job.away.get(net, 0) + count
        failure = None if job.visit is None else job.last_failure
        return Departure(job, failure, self.news(job, net), self.is_held(job))

    def news(self, job: Job, net: str) -> dict[str, object]:
        """Return the unreported results of a foreign job; the results of a job of the net stay here."""
        if job.visit is None:
            return {}
        try:
            results = recorded_data(job).results if self.keeps else plain_dict(job.results, "ctx.result")
        except NetError as unfit:
            self.notifier.troubled(f"the results for {job.symbol} are not sent to net {net}: {unfit}")
            return {}
        told = job.told.get(net, {})
        news = {name: value for name, value in results.items() if name not in told or told[name] != value}
        if news:
            job.told[net] = {**told, **news}
        return news

    def pass_on(self, job: Job, update: JobUpdate, error: ImError | None) -> None:
        """Tell an update of a job to the nets of the tokens, except the net of the job."""
        for net in job.away:
            if job.visit is None or job.visit.owner.key.net != net:
                self.outlet.send_job_update(self.net.name, job, update, net, error, {})

    def hold(self, number: int, held: bool, jobs: Iterable[Job], scope: str = "") -> None:
        """Begin nothing more for jobs, or go on, also in the nets of the tokens; see :attr:`held`."""
        if held == (number in self.held):
            return
        if held:
            self.held[number] = scope
        else:
            del self.held[number]
        for job in jobs:
            self.pass_on(job, JobUpdate.HELD if held else JobUpdate.RELEASED, None)

    @staticmethod
    def hold_number(job: Job) -> int:
        """Return the number for holding a job: for a command, the id of the command."""
        return job.command.id if job.is_command else -job.number

    def is_held(self, job: Job) -> bool:
        """Check whether nothing is begun for a job; a cancelled job may always end."""
        return not job.cancelled and (-job.number in self.held or self._is_held_by_command(job))

    def runs(self, activity: Activity) -> bool:
        """Return whether an action has not ended."""
        return self.activities.get(activity.number) is activity

    def is_paused(self, activity: Activity) -> bool:
        """Whether nothing is begun for the job of an action."""
        return activity.lineage.job is not None and self.is_held(activity.lineage.job)

    def _is_held_by_command(self, job: Job) -> bool:
        return job.visit is None and self.held.get(job.command.id) in ("", job.command.scope)

    @property
    def keeps(self) -> bool:
        """Whether a journal is written or replayed."""
        return self.replaying or self.record is not None

    def close(self, job: Job, error: ImError | None) -> None:
        """End a job, and answer the caller."""
        was_open = self.ledger.is_open(job)
        self.notifier.flush()
        self.ledger.close(job, error)
        self.tokens.disown(job)
        self.held.pop(-job.number, None)
        if self._is_held_by_command(job) and not any(map(self._is_held_by_command, self._of_number(job.command.id))):
            del self.held[job.command.id]
        if was_open:
            self.pass_on(job, JobUpdate.ENDED, None)
        for word in self.ledger.tape.waiting() if self._words else ():
            address = word.arguments.get(ADDRESS)
            if word.symbol in self._words and address is not None and not self._under_way(address):
                self.ledger.tape.withdraw(word)
                text = f"command {address}, for which {word.symbol} was, has ended"
                self.close(word, NetError(text, symbol=word.symbol, command=address))
        if was_open and job.request is not None:
            self.outlet.send_reply(job.request, error, job.results)

    def _of_number(self, number: int) -> list[Job]:
        return [job for job in self.ledger.jobs() if job.command.id == number]

    def _under_way(self, number: object) -> bool:
        return any(job.command.id == number and job.symbol not in self._words for job in self.ledger.jobs())

    def _awaits_acceptance(self, job: Job) -> bool:
        if job.request is None or job.from_tape:
            return False
        waiting = self.tokens.queues.get(self.place[input_place(job.request.service)], ())
        return any(lineage.job is job for lineage in waiting)

    def cancel(self, jobs: Iterable[Job], error: ImError) -> None:
        """End jobs early: jobs on the tape and abandoned ones now, the others after the end of the actions."""
        for job in jobs:
            if self.ledger.tape.withdraw(job):
                self.close(job, error)
            elif error.code == ABANDONED_CODE:
                self._abandon(job, error)
            else:
                self.pass_on(job, JobUpdate.CANCELLED, error)
                job.unwanted = self._awaits_acceptance(job) or self.is_held(job)
                job.cancelled = True
                job.last_failure = error

    def _abandon(self, job: Job, error: ImError) -> None:
        """End a job without its tokens and actions; give back the initial marking that these had taken."""
        self.pass_on(job, JobUpdate.CANCELLED, error)
        back = self.freed_by(job)
        for activity in self.actions_of(job):
            del self.activities[activity.number]
            self.enabling.take_tokens(activity.place, 1)
            duration = self.clock() - activity.began
            self.notifier.note(
                activity.transition, Phase.FAILED, activity.lineage, duration=duration, message=str(error)
            )
        self.tokens.drop(job)
        for place, count in back.items():
            self.mark_place(place, count, NO_LINEAGE)
        self.close(job, error)

    def actions_of(self, job: Job) -> list[Activity]:
        """Return the running actions of a job."""
        return [activity for activity in self.activities.values() if activity.lineage.job is job]

    def freed_by(self, job: Job) -> dict[str, int]:
        """Return the tokens that come back, by place, if a job is abandoned."""
        held = Counter(self.tokens.compiled.places[activity.place] for activity in self.actions_of(job))
        for place, queue in self.tokens.queues.items():
            held[self.tokens.compiled.places[place]] += sum(lineage.job is job for lineage in queue)
        return given_back(self.net, held)

    def emit(self, transition: Transition, lineage: Lineage) -> None:
        """Write the symbol of a transition to the output tape, possibly ending a job."""
        for emitted in transition.emit:
            self.notifier.emitted(emitted, lineage)
            visit = None if lineage.job is None else lineage.job.visit
            if lineage.job is not None and visit is not None and visit.owner.symbol:
                done = ends(emitted, visit.owner.symbol)
                if done is not None:
                    error = None if done else failure_of(lineage.job, transition, lineage.failure)
                    news = self.news(lineage.job, visit.owner.key.net)
                    self.outlet.send_job_update(
                        self.net.name, lineage.job, JobUpdate.CONCLUDED, visit.owner.key.net, error, news
                    )
                    continue
            job = self.ledger.ended_by(emitted, lineage.job)
            if job is not None:
                done = ends(emitted, job.symbol)
                self.close(job, None if done else failure_of(job, transition, lineage.failure))

    def consider_readers(self, symbol: str) -> None:
        """Decide on the readers of a symbol present on the tape."""
        if self.ledger.tape.has(symbol):
            for index in self.readers[symbol]:
                if not self.enabling.unmet[index]:
                    self.enabling.consider(index)

    # Firing.

    def withdraw(self, name: str) -> None:
        """Move the tokens of an invalid data object: for an object of a command, the tokens of the command."""
        for place, stands_for in self._withdrawable:
            index = self.number[f"{place}.withdrawn"]
            while self.enabling.tokens[self.place[place]]:
                of_it = [job for job in self.owners(index) if self.object_name(stands_for, job) == name]
                if not of_it:
                    break
                self.fire(index, of_it[0])

    def shown_objects(self) -> set[str]:
        """Return the data objects with tokens to move on a loss of validity now, by the names in the DOM."""
        shown: set[str] = set()
        for place, stands_for in self._withdrawable:
            number = self.place[place]
            if self.enabling.tokens[number]:
                jobs = {lineage.job for lineage in self.tokens.queues.get(number, (NO_LINEAGE,))}
                shown.update(self.object_name(stands_for, job) for job in jobs)
        return shown

    def object_name(self, name: str, job: Job | None) -> str:
        """Return the name in the DOM of a place's data object, for a token of a job."""
        command, arguments = (NO_COMMAND, {}) if job is None else (job.command, job.arguments)
        return object_name(name, scope_of(self.net.name, command), self.shared_objects, arguments)

    def owners(self, index: int) -> Sequence[Job | None]:
        """Return the possible jobs of a transition enabled by the arcs, oldest first; None: no job.

        That is a job that has tokens there, or, where tokens of nobody and a symbol begin one, a job on the tape.
        """
        owners = self.tokens.owners(index)
        if index in self._narrowed:
            owners = self._narrowed_owners(index, owners)
        if self.held and index not in self._withdrawing:
            owners = [owner for owner in owners if owner is None or not self.is_held(owner)]
        return owners

    def _narrowed_owners(self, index: int, owners: Sequence[Job | None]) -> Sequence[Job | None]:
        """Narrow the owners of tokens to owners a transition can fire for, where more than tokens decides."""
        if index in self.cancelling:
            return [owner for owner in owners if self._cancellable(index, owner) is not None]
        if index in self._finishing:
            return [owner for owner in owners if owner is None or owner.number in self.ledger.serving]
        if index in self._to_commands:
            return [owner for owner in owners if owner is not None and self._symbol_for(index, owner) is not None]
        waiting = self.ledger.tape.of_symbol(self.transitions[index].symbol or "")
        return [each for owner in owners for each in (waiting if owner is None else (owner,))]

    def first_owner(self, index: int) -> Job | None:
        """Return the first of :meth:`owners`; None also where there is none."""
        if not self.tokens.queues and index not in self.begins:
            return None
        owners = self.owners(index)
        return owners[0] if owners else None

    def _cancellable(self, index: int, owner: Job | None) -> Activity | None:
        """Return the oldest action of a job that a transition can ask to end early, None without one."""
        name = self.cancelling[index]
        acting = (each for each in self.activities.values() if each.transition == name and each.state is _ACTIVE)
        jobs = ((each, each.lineage.job) for each in acting)
        return next((each for each, job in jobs if job is owner or (owner is None and job and job.closed)), None)

    def _symbol_for(self, index: int, owner: Job | None) -> Job | None:
        """Return the oldest symbol on the tape readable by a transition for a command, None without one."""
        waiting = self.ledger.tape.of_symbol(self.transitions[index].symbol or "")
        if index not in self._to_commands or owner is None:
            return next(iter(waiting), None)
        number = owner.command.id
        return next((word for word in waiting if word.arguments.get(ADDRESS, number) == number), None)

    def foreseen(self, index: int, owner: Job | None) -> Lineage:
        """Return the lineage of a firing for a job: for free tokens, the command read from the tape."""
        if owner is not None and owner.waiting:
            return Lineage(owner, None)
        return self.tokens.peek_inputs(index, owner)

    def fire(self, index: int, owner: Job | None) -> Activity | None:
        """Fire an enabled transition.

        Args:
            index: Its number.
            owner: Whose tokens it takes, or whom it reads from the tape with tokens of nobody, one of :meth:`owners`;
                None: tokens of nobody, and the oldest of its symbol.

        Returns:
            The action that is now to begin, for ``t.start``; or the one that is to be asked to end early.
        """
        transition = self.transitions[index]
        if self.record is not None:
            number = None if owner is self.first_owner(index) else owner.number if owner is not None else 0
            self.record(TransitionFired(transition.name, number))
        word: Job | None = None
        if owner is not None and owner.waiting:
            word, owner = owner, None
        called_off = self._cancellable(index, owner) if index in self.cancelling else None
        lineage = self.tokens.take_inputs(index, owner)
        if called_off is not None:
            self.set_state(called_off, ActivityState.CANCELLING)
            called_off.cancelled = self.replaying
            called_off.doubt = interruption(transition, lineage.failure)
        if transition.symbol is not None:
            word = word or self._symbol_for(index, owner)
            assert word is not None
            self.ledger.tape.withdraw(word)
            self.consider_readers(transition.symbol)
            if owner is None and transition.symbol_of is None:
                lineage, word = Lineage(word, None), None
        activity = self._move_on(index, lineage)
        if word is not None and word.symbol not in self._answered:
            self.close(word, None)
        return called_off or activity

    def _move_on(self, index: int, lineage: Lineage) -> Activity | None:
        """Complete a firing after the tokens are taken."""
        transition = self.transitions[index]
        if transition.role is _START:
            return self.begin(index, lineage, transition.symbol or "")
        passed_on = lineage.failure if transition.keeps_failure else None
        if transition.role is not _PLAIN:
            lineage, passed_on = self._take_role(transition, lineage)
        self._give(index, lineage.failing(passed_on))
        message = str(lineage.failure) if lineage.failure is not None else ""
        symbol = transition.symbol or (transition.emit[0] if transition.emit else "")
        self.notifier.note(transition.name, _ENDED, lineage, symbol=symbol, message=message)
        self.emit(transition, lineage)
        return None

    def _take_role(self, transition: Transition, lineage: Lineage) -> tuple[Lineage, ImError | None]:
        """Take or answer a request, or withdraw an object, for a transition with more to do than moving tokens.

        Returns:
            The lineage that it fires for, and the failure that its tokens carry on.
        """
        passed_on: ImError | None = None
        match transition.role:
            case Role.ACCEPT:
                if lineage.job is not None:
                    self.ledger.serving[lineage.job.number] = lineage.job
                lineage = Lineage(lineage.job, None)
            case Role.FINISH:
                lineage = Lineage(self._served(lineage.job), None)
            case Role.FINISH_FAILED:
                served = self._served(lineage.job)
                passed_on = failure_of(served, transition, lineage.failure)
                lineage = Lineage(served, passed_on)
            case Role.RETURN if lineage.job is not None:
                self.close(lineage.job, lineage.failure)
            case Role.WITHDRAWN:
                name = self.object_name(self.net.places[transition.origin].data_object or "", lineage.job)
                passed_on = ImError(f"data object {name} lost its validity", code="data", object=name)
                if lineage.job is not None:
                    lineage.job.last_failure = passed_on
        return lineage, passed_on

    def _served(self, job: Job | None) -> Job | None:
        """Take the answered request of a firing from the requests in service: the oldest, for free tokens."""
        serving = self.ledger.serving
        number = job.number if job is not None else next(iter(serving), 0)
        return serving.pop(number, None)

    def begin(self, index: int, lineage: Lineage, symbol: str) -> Activity:
        """Mark ``t.active`` for taken tokens; return the action to begin."""
        origin = self.transitions[index].origin
        self.notifier.note(origin, _STARTED, lineage, symbol=symbol)
        activity = self.new_activity(origin, self.notifier.sequence, lineage)
        self.enabling.add_tokens(activity.place, 1)
        self.activities[activity.number] = activity
        return activity

    def new_activity(self, transition: str, number: int, lineage: Lineage) -> Activity:
        """Return the record of an action at the beginning.

        Raises:
            KeyError: The net as written has no such transition with an action.
        """
        start, active, _, named = self._phases[transition]
        assert start.action is not None
        objects = tuple(self.object_name(found, lineage.job) for found in named) if named else ()
        return Activity(number, self.net.name, transition, start.action, lineage, self.clock(), active, objects=objects)

    def set_state(self, activity: Activity, state: ActivityState) -> None:
        """Set the state of an action, and the place of the token."""
        activity.state, activity.place = state, self._phases[activity.transition].places[state]

    def move(self, activity: Activity, state: ActivityState, error: ImError) -> None:
        """Fire ``t.cancel`` or ``t.lost`` of an activity.

        Args:
            activity: One of :attr:`activities`.
            state: What it comes to.
            error: Why.
        """
        name = f"{activity.transition}.{'cancel' if state is ActivityState.CANCELLING else 'lost'}"
        if activity.state is ActivityState.CANCELLING:
            name = f"{name}.cancelling"
        if self.record is not None:
            self.record(PhaseFired(activity.number, name, error))
        self.enabling.take_tokens(activity.place, 1)
        self.set_state(activity, state)
        self.enabling.add_tokens(activity.place, 1)
        if state is ActivityState.IN_DOUBT:
            activity.doubt, activity.doubted = error, self.clock()
        phase = Phase.DOUBT if state is ActivityState.IN_DOUBT else Phase.CANCEL
        duration = self.clock() - activity.began
        self.notifier.note(activity.transition, phase, activity.lineage, duration=duration, message=str(error))

    def end_action(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> ImError | None:
        """Fire ``t.end``, ``t.failed`` or ``t.given_up`` of an activity.

        Args:
            activity: One of :attr:`activities`.
            error: Why it failed, None if it has confirmed; of code ``in_doubt`` where nobody can tell.
            results: Results of a request, or what is kept of another answer.

        Returns:
            Why it failed after all.
        """
        job, data = activity.lineage.job, None
        if results and job is not None and hands_on(activity):
            job.results.update(results)
        if job is not None and self.record is not None:
            try:
                data = changed_data(job)
            except NetError as unfit:
                error = error or unfit
        name = f"{activity.transition}.{'failed' if error else 'end'}"
        if activity.state is not _ACTIVE:
            name = f"{name}.{activity.state}"
        if error is not None and error.code == DOUBT_CODE and activity.state is ActivityState.IN_DOUBT:
            given_up = f"{activity.transition}.given_up"
            name = given_up if given_up in self.number else name
        if self.record is not None:
            self.record(EndFired(activity.number, name, error, data))
        self.end(activity, name, error, results)
        return error

    def keep_data(self, activity: Activity) -> None:
        """Record the changes of a running action in the job, if any; none of an ended one.

        Raises:
            NetError: JSON cannot carry it; the job has what it had.
        """
        job = activity.lineage.job
        if job is None or self.record is None or not self.runs(activity):
            return
        data = changed_data(job)
        if data is not None:
            self.record(MessageBuilt(activity.number, data))

    def end(self, activity: Activity, name: str, error: ImError | None, results: dict[str, object]) -> None:
        """Fire a transition at the end of an activity."""
        del self.activities[activity.number]
        job, index = activity.lineage.job, self.number[name]
        failure = None if error is None else self._passed_on(activity, index, error)
        if job is not None and error is not None:
            job.unwanted = False
        only_waited = isinstance(activity.action, AwaitAction) and is_interrupted(activity)
        tries_again = error is not None and self._has_another_try(activity, index)
        if job is not None and failure is not None and not only_waited and not tries_again:
            job.last_failure = failure
        elif job is not None and (results or isinstance(activity.action, RequestAction)):
            job.replies[self.answering(activity)] = results
        self.enabling.take_tokens(activity.place, 1)
        kept = activity.lineage.failure if self._keeps_failure(activity) and (error is None or tries_again) else None
        lineage = activity.lineage.failing(kept or failure)
        self._give(index, lineage)
        transition = self.transitions[index]
        self.notifier.note(
            activity.transition,
            Phase.FAILED if error else _ENDED,
            lineage,
            symbol=transition.emit[0] if transition.emit else "",
            duration=self.clock() - activity.began,
            message=str(error) if error else "",
        )
        self.emit(transition, lineage)

    def _passed_on(self, activity: Activity, failed: int, error: ImError) -> ImError:
        """Return the failure on tokens: the earlier one is not hidden on the way, nor where it is kept."""
        before, ended = activity.lineage.failure, self.transitions[self.number[f"{activity.transition}.end"]]
        without_effect = ended.outputs == self.transitions[failed].outputs
        if before is None or not (without_effect or self._keeps_failure(activity)):
            return error
        told = f"{before.message}; {activity.transition} failed, too: {error.message}"
        return ImError.restored(before.code, told, before.facts)

    def _keeps_failure(self, activity: Activity) -> bool:
        """Return whether the tokens of an action carry the failure that the action works for."""
        return self._phases[activity.transition].start.keeps_failure

    def _has_another_try(self, activity: Activity, failed: int) -> bool:
        """Return whether a failure leads to a further try: a mended failure does not fail the command."""
        first, given = self.answering(activity), self.transitions[failed].outputs.keys()
        return any(
            transition.retry_of == first and not given.isdisjoint(transition.inputs)
            for transition in self.net.transitions.values()
            if transition.retry_of is not None
        )

    def answering(self, activity: Activity) -> str:
        """Return the transition credited with an action's answer: of a further try, the first one."""
        return self._phases[activity.transition].start.retry_of or activity.transition

    def _give(self, index: int, lineage: Lineage) -> None:
        """Mark the outputs of a firing: the tokens belong to the job, if still open."""
        if lineage.job is not None and lineage.job.closed:
            lineage = NO_LINEAGE
        self.tokens.give_outputs(index, lineage)
        for target, count in self.transitions[index].remote_outputs.items():
            self.outlet.send_token(self.net.name, target, count, self._departure(lineage.job, target.net, count))


def interruption(transition: Transition, failure: ImError | None) -> ImError:
    """Return the failure of an action that a transition asks to end early, perhaps for a failure of its own."""
    by = transition.title or transition.origin
    text = f"interrupted by {by}" if failure is None else f"interrupted, for {by} cannot be told: {failure.message}"
    return ImError(text, code=INTERRUPTED_CODE)


def is_interrupted(activity: Activity) -> bool:
    """Whether a transition has asked an action to end early, and nothing else."""
    job, why = activity.lineage.job, activity.doubt
    interrupted = why is not None and why.code == INTERRUPTED_CODE
    return interrupted and activity.state is ActivityState.CANCELLING and not (job is not None and job.cancelled)


def hands_on(activity: Activity) -> bool:
    """Return whether an action passes the command on to another net: the reply is the result."""
    job = activity.lineage.job
    if job is None or job.request is not None or not isinstance(activity.action, RequestAction):
        return False
    return activity.action.service == job.command.symbol
