"""Two-phase firing of a net (paper, section 6): tokens leave, the action runs, outputs are marked when it confirms.

What is here is deterministic: it is done again, in the same order, when a journal is replayed. What decides, waits or
calls foreign code is elsewhere.
"""

from collections.abc import Callable, Iterable, Sequence

from im_core.errors import ImError
from im_pnt.errors import NetError
from im_pnt.execution.events import (
    CommandCancelled,
    CommandHeld,
    CommandWritten,
    ModeSet,
    NodeForgotten,
    PauseSet,
    RequestArrived,
    RequestCancelled,
    Tiding,
    TidingArrived,
    TokenArrived,
)
from im_pnt.execution.jobs import (
    NO_COMMAND,
    NO_LINEAGE,
    Activity,
    ActivityState,
    Carried,
    Job,
    Ledger,
    Lineage,
    Reply,
    Request,
    Visit,
    ends,
    filled_name,
    object_name,
    scope_of,
)
from im_pnt.execution.marking import Tokens
from im_pnt.execution.notification import Leaving, Notifier, Observer, Outlet, Phase, failure_of
from im_pnt.execution.record import (
    ActivityEnded,
    EndFired,
    GuardBroke,
    JobForgotten,
    NetEntry,
    PhaseFired,
    Record,
    TransitionFired,
    VisitSettled,
    add_results,
    changed_data,
    plain_dict,
    recorded_data,
    restore_data,
    take_data,
)
from im_pnt.execution.values import NetValues, Objects
from im_pnt.model.action import RequestAction
from im_pnt.model.compiled import compile_net
from im_pnt.model.expand import active_place, cancelling_place, doubt_place, expand, input_place
from im_pnt.model.net import Net, ObjectScope, ReadFor, Role, Transition
from im_pnt.model.resources import resource_places

ADDRESS = "command"
"""Argument of a word to a command: the number of that command; without it, it is for whichever asks first."""
DOUBT_CODE = "in_doubt"
"""Code of the error of an action of which nobody can tell what became."""
_WAITING_ROLES = (Role.END, Role.FAILED, Role.CANCEL, Role.LOST, Role.GIVEN_UP, Role.WITHDRAWN)
_PHASE_PLACES = {
    ActivityState.ACTIVE: active_place,
    ActivityState.CANCELLING: cancelling_place,
    ActivityState.IN_DOUBT: doubt_place,
}


class FiringRule:
    """The marking and the jobs of a net, and what firing does to them.

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
        call: A ``t.start`` whose function is being called, and since when [s]: its token is on ``t.active``, nothing
            belongs to it, and it is made an activity only where one is needed.
        callee: The activity that was made so last.
        expires: For each symbol that does not wait for ever, how long it does [s].
        choosy: Transitions that tokens alone do not enable: it matters whose they are.
        begins: Transitions that begin a command where they read a symbol with tokens of nobody.
        held: Numbers of the commands for which nothing is begun; of a visit its number here, negative.
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
        resources = {self.place[name] for name in declared | resource_places(net)}
        self.tokens = Tokens(compiled, free, initial, resources)
        self.enabling = self.tokens.enabling
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
        self.choosy = self.tokens.choosy | self._finishing | self._to_commands
        beginning = (i for i in free if self.transitions[i].symbol and self.transitions[i].symbol_of is None)
        self.begins = frozenset(beginning)
        self.held: set[int] = set()
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
        self.call: tuple[int, float] | None = None
        self.callee: Activity | None = None

    # What a journal is told, and what is done again when it is replayed.

    def happens(self, entry: NetEntry) -> None:
        """Tells the journal what happens, and does it."""
        if self.record is not None:
            self.record(entry)
        self.apply(entry)

    def apply(self, entry: NetEntry) -> None:
        """Does what an entry tells.

        Raises:
            ValueError: It does not fit the net, or what has happened to it.
            LookupError: Likewise.
        """
        match entry:
            case TransitionFired(name, number):
                self._fire_again(name, number)
            case TokenArrived(place, count, None):
                self.mark_place(place, count, NO_LINEAGE)
            case TokenArrived():
                self._take_token(entry)
            case TidingArrived():
                self._hear(entry)
            case NodeForgotten(node, nets, error):
                self._forget_node(node, nets, error)
            case VisitSettled(number):
                self._leave(self._open_job(number))
            case EndFired(number, name, error, data):
                activity = self._running(number, name)
                if data is not None and activity.lineage.job is not None:
                    take_data(activity.lineage.job, data)
                self._end(activity, name, error, activity.reply.results if activity.reply is not None else {})
            case PhaseFired(number, name, error):
                activity = self._running(number, name)
                activity.cancelled = True
                doubtful = name.endswith((".lost", ".lost.cancelling"))
                self.move(activity, ActivityState.IN_DOUBT if doubtful else ActivityState.CANCELLING, error)
            case ActivityEnded(number, failure, results):
                if number in self.activities:
                    self.activities[number].reply = Reply(failure, results)
            case CommandWritten(job):
                if job.symbol not in self.readers:
                    raise ValueError(f"the net does not know the command {job.symbol}")
                self.write(job)
            case RequestArrived(request):
                self.take_request(request)
            case CommandCancelled(command_id, error):
                self.cancel(self.ledger.of_command(command_id), error)
            case RequestCancelled(request_id, error):
                self.cancel(self.ledger.of_request(request_id), error)
            case CommandHeld(command_id, held):
                self._hold(command_id, held, self.ledger.of_command(command_id))
            case GuardBroke(number, error):
                self._open_job(number).last_failure = error
            case JobForgotten(number, error):
                job = self._open_job(number)
                self.ledger.tape.withdraw(job)
                self.close(job, error)
            case ModeSet() | PauseSet():
                raise ValueError("it is for the operator of the net")

    def _fire_again(self, name: str, number: int | None) -> None:
        index = self.number[name]
        symbol = self.transitions[index].symbol
        if self.enabling.unmet[index] or (symbol is not None and not self.ledger.tape.has(symbol)):
            raise ValueError(f"{name} is not enabled")
        owners = self.owners(index)
        if number is None:  # a journal of before may tell of a firing that took what belongs to several
            self.fire(index, owners[0] if owners else max(self.tokens.jobs(index), key=lambda job: job.number))
            return
        if number == 0 and index in self.begins:  # a journal of before, when the oldest of a symbol was read
            self.fire(index, None)
            return
        if number not in [owner.number if owner is not None else 0 for owner in owners]:
            raise ValueError(f"{name} is not enabled for job {number}")
        self.fire(index, self.ledger.job(number))

    def _running(self, number: int, name: str) -> Activity:
        activity, index = self.activities[number], self.number[name]
        if self.enabling.unmet[index] or self.transitions[index].origin != activity.transition:
            raise ValueError(f"{name} is not enabled")
        return activity

    def _open_job(self, number: int) -> Job:
        job = self.ledger.job(number)
        if job is None:
            raise ValueError(f"no job of number {number} is open")
        return job

    # What comes from outside.

    def mark_place(self, place: str, count: int, lineage: Lineage) -> None:
        """Puts tokens on a place from outside."""
        if lineage is NO_LINEAGE and not self.tokens.queues:
            self.enabling.add_tokens(self.place[place], count)
        else:
            self.tokens.put_tokens(self.place[place], count, lineage)

    def write(self, job: Job) -> None:
        """Puts a job on the input tape."""
        self.ledger.add(job)
        address = job.arguments.get(ADDRESS)
        if job.symbol in self._words and address is not None and not self._under_way(address):
            text = f"{job.symbol} is for command {address}, which is not under way"
            self.close(job, NetError(text, symbol=job.symbol, command=address))
            return
        self.ledger.tape.write(job)
        self.consider_readers(job.symbol)

    def take_request(self, request: Request) -> None:
        """Takes a request: to the place I of its service, or, where it names a symbol, to the input tape."""
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

    # Jobs whose tokens cross between nets. Who sends a token is told when its work is done, there and wherever it has
    # led to: so a net knows where its jobs are, and what is said of them follows their tokens (E.W. Dijkstra and
    # C.S. Scholten, "Termination detection for diffusing computations", 1980). Cancels and pauses are believed of who
    # has sent the first token, so that each comes once and in order.

    def _take_token(self, event: TokenArrived) -> None:
        """Takes a token of a job that comes from another net."""
        carried = event.carried
        assert carried is not None
        owner, home = carried.owner, carried.home
        job, place = self.ledger.of_key(owner.key, home), self.place[event.place]
        known, stays = job is not None, self.tokens.carries(place)
        if job is None and stays and not home:
            job = Job(owner.command, owner.arguments, visit=Visit(owner, carried.node, carried.net))
            self.ledger.add(job)
        if job is not None:
            add_results(job, carried.results, self._keeps)
            job.last_failure = carried.failure or job.last_failure
        if job is not None and not home:
            if carried.held:
                self._hold(-job.number, True, [job])
            if carried.cancelled is not None and not job.cancelled:
                self.cancel([job], carried.cancelled)
        self.tokens.put_tokens(place, event.count, NO_LINEAGE if job is None else Lineage(job, None))
        if known or job is None:
            self.outlet.send_settled(self.net.name, owner.key, carried.node, carried.net, None, {})

    def _hear(self, event: TidingArrived) -> None:
        """Does what another net tells of a job whose tokens have crossed."""
        job = self.ledger.of_key(event.key, event.home)
        if job is None:  # it has ended meanwhile
            return
        match event.tiding:
            case Tiding.SETTLED:
                add_results(job, event.results, self._keeps)
                job.last_failure = event.error or job.last_failure
                left = job.away.get(event.net, 0) - 1
                if left > 0:
                    job.away[event.net] = left
                else:
                    job.away.pop(event.net, None)
            case Tiding.CANCELLED if _is_from_parent(job, event.net):
                self.cancel([job], event.error or cancelled_elsewhere(event.net))
            case Tiding.HELD | Tiding.RELEASED if _is_from_parent(job, event.net):
                self._hold(-job.number, event.tiding is Tiding.HELD, [job])
            case Tiding.ENDED:
                self.close(job, None)
            case Tiding.CONCLUDED if event.home and job.from_tape:
                add_results(job, event.results, self._keeps)
                self.close(job, event.error)

    def cancelled_visit(self, event: object) -> Job | None:
        """Returns the job of another net whose actions an event will have to end early, None where there is none."""
        match event:
            case TokenArrived(carried=Carried(owner=owner, home=False, cancelled=ImError())):
                job = self.ledger.visits.get(owner.key)
                return None if job is None or job.cancelled else job
            case TidingArrived(key=key, tiding=Tiding.CANCELLED, net=net):
                job = self.ledger.visits.get(key)
                return job if job is not None and _is_from_parent(job, net) else None
        return None

    def _forget_node(self, node: str, nets: Iterable[str], error: ImError) -> None:
        """Gives up what has gone to a node, and ends what has come from it."""
        for job in self.ledger.jobs():
            for net in job.away.keys() & set(nets):
                del job.away[net]
                job.last_failure = error
                self.outlet.send_tiding(self.net.name, job, Tiding.ENDED, net, error, {})
            if job.visit is not None and job.visit.node == node:
                self.cancel([job], error)
                self._leave(job)

    def settle_visits(self) -> None:
        """Lets the jobs of other nets go of which nothing is left here."""
        left = {lineage.job for queue in self.tokens.queues.values() for lineage in queue}
        left |= {activity.lineage.job for activity in self.activities.values()}
        for job in list(self.ledger.visits.values()):
            if job not in left and not job.away:
                self.happens(VisitSettled(job.number))

    def _leave(self, job: Job) -> None:
        """Ends a visit, and tells who has sent its first token."""
        visit = job.visit
        assert visit is not None
        results = self._news(job, visit.net)
        self.close(job, None)
        self.outlet.send_settled(self.net.name, visit.owner.key, visit.node, visit.net, job.last_failure, results)

    def _leaving(self, job: Job | None, net: str, count: int) -> Leaving | None:
        """Returns what tokens take along to another net, None where they are nobody's; their job is away there."""
        if job is None:
            return None
        job.away[net] = job.away.get(net, 0) + count
        failure = None if job.visit is None else job.last_failure
        return Leaving(job, failure, self._news(job, net), self.is_held(job))

    def _news(self, job: Job, net: str) -> dict[str, object]:
        """Returns the results of a visit that a net has not been told; those of a job that is at home stay there."""
        if job.visit is None:
            return {}
        try:
            results = recorded_data(job).results if self._keeps else plain_dict(job.results, "ctx.result")
        except NetError as unfit:
            self.notifier.troubled(f"what was done for {job.symbol} is not told to net {net}: {unfit}")
            return {}
        told = job.told.get(net, {})
        news = {name: value for name, value in results.items() if name not in told or told[name] != value}
        if news:
            job.told[net] = {**told, **news}
        return news

    def _pass_on(self, job: Job, tiding: Tiding, error: ImError | None) -> None:
        """Tells the nets where tokens of a job have gone what becomes of it; not its own, from where that comes."""
        for net in job.away:
            if job.visit is None or job.visit.owner.key.net != net:
                self.outlet.send_tiding(self.net.name, job, tiding, net, error, {})

    def _hold(self, number: int, held: bool, jobs: Iterable[Job]) -> None:
        if held == (number in self.held):
            return
        if held:
            self.held.add(number)
        else:
            self.held.discard(number)
        for job in jobs:
            self._pass_on(job, Tiding.HELD if held else Tiding.RELEASED, None)

    def is_held(self, job: Job) -> bool:
        """Whether nothing is begun for a job."""
        return (job.command.id if job.visit is None else -job.number) in self.held

    @property
    def _keeps(self) -> bool:
        """Whether a journal is told what happens, or tells it."""
        return self.replaying or self.record is not None

    def close(self, job: Job, error: ImError | None) -> None:
        """Ends a job, and answers whoever asked for it."""
        was_open = self.ledger.is_open(job)
        self.notifier.flush()
        self.ledger.close(job, error)
        self.tokens.disown(job)
        if job.visit is not None:
            self.held.discard(-job.number)
        elif job.command.id in self.held and all(each.command.id != job.command.id for each in self.ledger.jobs()):
            self.held.discard(job.command.id)
        if was_open:
            self._pass_on(job, Tiding.ENDED, None)
        for word in self.ledger.tape.waiting() if self._words else ():
            address = word.arguments.get(ADDRESS)
            if word.symbol in self._words and address is not None and not self._under_way(address):
                self.ledger.tape.withdraw(word)
                text = f"command {address}, for which {word.symbol} was, has ended"
                self.close(word, NetError(text, symbol=word.symbol, command=address))
        if was_open and job.request is not None:
            self.outlet.send_reply(job.request, error, job.results)

    def _under_way(self, number: object) -> bool:
        return any(job.command.id == number and job.symbol not in self._words for job in self.ledger.jobs())

    def expire(self, job: Job) -> None:
        """Ends a symbol that still waits to be read, when it does so no longer."""
        if job.waiting:
            seconds = self.expires[job.symbol]
            limit = f"within {seconds:g} s" if seconds else "before the net came to rest"
            text = f"nothing has asked for {job.symbol} {limit}"
            self.happens(JobForgotten(job.number, NetError(text, net=self.net.name, symbol=job.symbol)))

    def drop_stale(self) -> None:
        """Ends the symbols that nothing waits for as the net comes to rest, where they do not wait themselves."""
        for symbol, seconds in self.expires.items():
            asked = any(not self.enabling.unmet[index] and self.owners(index) for index in self.readers[symbol])
            if seconds == 0.0 and not asked:
                for job in list(self.ledger.tape.of_symbol(symbol)):
                    self.expire(job)

    def _awaits_acceptance(self, job: Job) -> bool:
        if job.request is None or job.from_tape:
            return False
        waiting = self.tokens.queues.get(self.place[input_place(job.request.service)], ())
        return any(lineage.job is job for lineage in waiting)

    def close_forgotten(self) -> None:
        """Ends the commands that a net at rest can acknowledge no more, so that no client waits in vain."""
        if not len(self.ledger) or self.activities or self.enabling.clocks:
            return
        begun = self.ledger.begun_commands()
        if not begun or any(place not in self.net.rest_places() for place in self.tokens.marking()):
            return
        for job in begun:
            if job.away:
                continue
            text = f"net {self.net.name} came to rest and emitted neither {job.symbol}_done nor {job.symbol}_failed"
            error = job.last_failure or ImError(text, code="net", symbol=job.symbol)
            self.happens(JobForgotten(job.number, error))

    def cancel(self, jobs: Iterable[Job], error: ImError) -> None:
        """Has jobs end early: those on the tape now, the others when what is done for them has ended."""
        for job in jobs:
            if self.ledger.tape.withdraw(job):
                self.close(job, error)
            else:
                self._pass_on(job, Tiding.CANCELLED, error)
                job.cancelled = True
                job.unwanted = self._awaits_acceptance(job)
                job.last_failure = error

    def guard_broke(self, job: Job, error: ImError) -> None:
        """Keeps why a guard broke, as the last failure of its job."""
        self.happens(GuardBroke(job.number, error))

    def emit(self, transition: Transition, lineage: Lineage) -> None:
        """Writes to the output tape what a transition emits; that may end a job."""
        for emitted in transition.emit:
            self.notifier.emitted(emitted, lineage)
            visit = None if lineage.job is None else lineage.job.visit
            if lineage.job is not None and visit is not None and visit.owner.symbol:
                done = ends(emitted, visit.owner.symbol)
                if done is not None:
                    error = None if done else failure_of(lineage.job, transition, lineage.failure)
                    news = self._news(lineage.job, visit.owner.key.net)
                    self.outlet.send_tiding(
                        self.net.name, lineage.job, Tiding.CONCLUDED, visit.owner.key.net, error, news
                    )
                    continue
            job = self.ledger.ended_by(emitted, lineage.job)
            if job is not None:
                done = ends(emitted, job.symbol)
                self.close(job, None if done else failure_of(job, transition, lineage.failure))

    def consider_readers(self, symbol: str) -> None:
        """Decides about the transitions that read a symbol, if it is on the tape."""
        if self.ledger.tape.has(symbol):
            for index in self.readers[symbol]:
                if not self.enabling.unmet[index]:
                    self.enabling.consider(index)

    # Firing.

    def withdraw(self, name: str) -> None:
        """Moves the tokens of a data object that has lost its validity: those of the command whose object it is.

        Args:
            name: Its name in the DOM.
        """
        for place, stands_for in self._withdrawable:
            index = self.number[f"{place}.withdrawn"]
            while self.enabling.tokens[self.place[place]]:
                of_it = [job for job in self.owners(index) if self.object_name(stands_for, job) == name]
                if not of_it:
                    break
                self.fire(index, of_it[0])

    def shown_objects(self) -> set[str]:
        """Returns the data objects whose loss of validity would move a token now, by their names in the DOM."""
        shown: set[str] = set()
        for place, stands_for in self._withdrawable:
            number = self.place[place]
            if self.enabling.tokens[number]:
                jobs = {lineage.job for lineage in self.tokens.queues.get(number, (NO_LINEAGE,))}
                shown.update(self.object_name(stands_for, job) for job in jobs)
        return shown

    def object_name(self, name: str, job: Job | None) -> str:
        """Returns the name in the DOM of a data object that a place names, for a token of a job."""
        command, arguments = (NO_COMMAND, {}) if job is None else (job.command, job.arguments)
        return object_name(filled_name(name, arguments), scope_of(self.net.name, command), self.shared_objects)

    def owners(self, index: int) -> Sequence[Job | None]:
        """Returns for whom a transition that its arcs enable can fire, oldest first; None: for nobody.

        That is a job that has tokens there, or, where tokens of nobody and a symbol begin one, a job on the tape.
        """
        owners = self.tokens.owners(index)
        if index in self._finishing:
            owners = [owner for owner in owners if owner is None or owner.number in self.ledger.serving]
        elif index in self._to_commands:
            owners = [owner for owner in owners if owner is not None and self._symbol_for(index, owner) is not None]
        elif index in self.begins:
            waiting = self.ledger.tape.of_symbol(self.transitions[index].symbol or "")
            owners = [each for owner in owners for each in (waiting if owner is None else (owner,))]
        if self.held and index not in self._withdrawing:
            owners = [owner for owner in owners if owner is None or not self.is_held(owner)]
        return owners

    def _symbol_for(self, index: int, owner: Job | None) -> Job | None:
        """Returns the oldest on the tape that a transition may read for a command, None where there is none."""
        waiting = self.ledger.tape.of_symbol(self.transitions[index].symbol or "")
        if index not in self._to_commands or owner is None:
            return next(iter(waiting), None)
        number = owner.command.id
        return next((word for word in waiting if word.arguments.get(ADDRESS, number) == number), None)

    def foreseen(self, index: int, owner: Job | None) -> Lineage:
        """Returns what a firing for a job would go on with: where the tokens are of nobody, the command it reads."""
        if owner is not None and owner.waiting:
            return Lineage(owner, None)
        return self.tokens.peek_inputs(index, owner)

    def fire(self, index: int, owner: Job | None) -> Activity | None:
        """Fires an enabled transition.

        Args:
            index: Its number.
            owner: Whose tokens it takes, or whom it reads from the tape with tokens of nobody, one of :meth:`owners`;
                None: tokens of nobody, and the oldest of its symbol.

        Returns:
            The action that is now to begin, for ``t.start``.
        """
        transition = self.transitions[index]
        if self.record is not None:
            first = owner is None and not self.tokens.queues
            first = first or owner is next(iter(self.owners(index)), None)
            number = None if first else owner.number if owner is not None else 0
            self.record(TransitionFired(transition.name, number))
        word: Job | None = None
        if owner is not None and owner.waiting:
            word, owner = owner, None
        lineage = self.tokens.take_inputs(index, owner)
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
        return activity

    def _move_on(self, index: int, lineage: Lineage) -> Activity | None:
        """Does what a firing does with the tokens that it has taken."""
        transition = self.transitions[index]
        passed_on: ImError | None = None
        match transition.role:
            case Role.START:
                return self.begin(index, lineage, transition.symbol or "")
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
        self._give(index, Lineage(lineage.job, passed_on))
        message = str(lineage.failure) if lineage.failure is not None else ""
        symbol = transition.symbol or (transition.emit[0] if transition.emit else "")
        self.notifier.note(transition.name, Phase.END, lineage, symbol=symbol, message=message)
        self.emit(transition, lineage)
        return None

    def _served(self, job: Job | None) -> Job | None:
        """Takes the request that a firing answers from those in service: the oldest, where its tokens are nobody's."""
        serving = self.ledger.serving
        number = job.number if job is not None else next(iter(serving), 0)
        return serving.pop(number, None)

    def begin(self, index: int, lineage: Lineage, symbol: str) -> Activity:
        """Marks ``t.active`` for tokens that were taken; returns the action that is to begin."""
        transition = self.transitions[index]
        self.enabling.add_tokens(self.place[active_place(transition.origin)], 1)
        self.notifier.note(transition.origin, Phase.START, lineage, symbol=symbol)
        activity = self.new_activity(index, self.notifier.sequence, lineage)
        self.activities[activity.number] = activity
        return activity

    def called(self, index: int | None = None) -> Activity | None:
        """Makes an activity of the function that is being called; None if none is, or not that of ``index``."""
        if self.call is None or (index is not None and index != self.call[0]):
            return None
        index, began = self.call
        self.call = None
        activity = self.new_activity(index, self.notifier.sequence, NO_LINEAGE)
        activity.began = began
        place = self.place[active_place(activity.transition)]
        self.enabling.tokens[place] -= 1  # where it was put without what it enables
        self.enabling.add_tokens(place, 1)
        self.callee = self.activities[activity.number] = activity
        return activity

    def new_activity(self, index: int, number: int, lineage: Lineage) -> Activity:
        """Returns what is known of an action when it begins."""
        transition, places = self.transitions[index], self.net.places
        assert transition.action is not None
        end = self.net.transitions[f"{transition.origin}.end"]
        named = [found for place in end.outputs if (found := places[place].data_object) is not None]
        objects = tuple(self.object_name(found, lineage.job) for found in named)
        name, action = transition.origin, transition.action
        return Activity(number, self.net.name, name, action, lineage, self.clock(), objects=objects)

    def move(self, activity: Activity, state: ActivityState, error: ImError) -> None:
        """Fires ``t.cancel`` or ``t.lost`` of an activity.

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
        self._leave_phase(activity)
        activity.state = state
        if activity.lineage.job is not None:
            activity.lineage.job.unwanted = False
        self.enabling.add_tokens(self.place[_PHASE_PLACES[state](activity.transition)], 1)
        if state is ActivityState.IN_DOUBT:
            activity.doubt, activity.doubted = error, self.clock()
        phase = Phase.DOUBT if state is ActivityState.IN_DOUBT else Phase.CANCEL
        duration = self.clock() - activity.began
        self.notifier.note(activity.transition, phase, activity.lineage, duration=duration, message=str(error))

    def end_action(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> ImError | None:
        """Fires ``t.end``, ``t.failed`` or ``t.given_up`` of an activity.

        Args:
            activity: One of :attr:`activities`.
            error: Why it failed, None if it has confirmed; of code ``in_doubt`` where nobody can tell.
            results: Results of a request, or what is kept of another answer.

        Returns:
            Why it failed after all.
        """
        job, data = activity.lineage.job, None
        if job is not None and hands_on(activity):
            job.results.update(results)
        if job is not None and self.record is not None:
            try:
                data = changed_data(job)
            except NetError as unfit:
                restore_data(job)
                error = error or unfit
        name = f"{activity.transition}.{'failed' if error else 'end'}"
        if activity.state is not ActivityState.ACTIVE:
            name = f"{name}.{activity.state}"
        if error is not None and error.code == DOUBT_CODE and activity.state is ActivityState.IN_DOUBT:
            given_up = f"{activity.transition}.given_up"
            name = given_up if given_up in self.number else name
        if self.record is not None:
            self.record(EndFired(activity.number, name, error, data))
        self._end(activity, name, error, results)
        return error

    def _end(self, activity: Activity, name: str, error: ImError | None, results: dict[str, object]) -> None:
        """Fires a transition that ends an activity."""
        del self.activities[activity.number]
        job, index = activity.lineage.job, self.number[name]
        if job is not None and error is not None and not self._has_another_try(activity, index):
            job.last_failure = error
        elif job is not None and (results or isinstance(activity.action, RequestAction)):
            job.replies[self.answering(activity)] = results
        self._leave_phase(activity)
        lineage = Lineage(job, error)
        self._give(index, lineage)
        transition = self.transitions[index]
        self.notifier.note(
            activity.transition,
            Phase.FAILED if error else Phase.END,
            lineage,
            symbol=transition.emit[0] if transition.emit else "",
            duration=self.clock() - activity.began,
            message=str(error) if error else "",
        )
        self.emit(transition, lineage)

    def _has_another_try(self, activity: Activity, failed: int) -> bool:
        """Whether what a failure gives goes to a further try: what that makes good is not why a command fails."""
        first, given = self.answering(activity), self.transitions[failed].outputs.keys()
        return any(
            transition.retry_of == first and not given.isdisjoint(transition.inputs)
            for transition in self.net.transitions.values()
            if transition.retry_of is not None
        )

    def answering(self, activity: Activity) -> str:
        """Returns the transition as whose answer that of an action counts: of a further try, the first one."""
        return self.transitions[self.number[f"{activity.transition}.start"]].retry_of or activity.transition

    def _leave_phase(self, activity: Activity) -> None:
        self.enabling.take_tokens(self.place[_PHASE_PLACES[activity.state](activity.transition)], 1)

    def _give(self, index: int, lineage: Lineage) -> None:
        """Marks what a firing gives: its tokens belong to its job, where that has not ended."""
        if lineage.job is not None and lineage.job.closed:
            lineage = NO_LINEAGE
        self.tokens.give_outputs(index, lineage)
        for target, count in self.transitions[index].remote_outputs.items():
            self.outlet.send_token(self.net.name, target, count, self._leaving(lineage.job, target.net, count))


def _is_from_parent(job: Job, net: str) -> bool:
    return job.visit is not None and job.visit.net == net


def cancelled_elsewhere(net: str) -> ImError:
    """Returns why a job ends early whose tokens have come from a net where it was cancelled."""
    return ImError(f"cancelled by net {net}", code="cancelled", net=net)


def hands_on(activity: Activity) -> bool:
    """Whether an action asks another net for the very command that it works for: what comes back is its result."""
    job = activity.lineage.job
    if job is None or job.request is not None or not isinstance(activity.action, RequestAction):
        return False
    return activity.action.service == job.command.symbol
