"""A net in execution as it stands: its marking, its jobs, the actions that run; and what comes to it from outside."""

from collections.abc import Callable, Iterable

from im_core.errors import ImError
from im_pnt.compiled import compile_net
from im_pnt.events import Observer
from im_pnt.expand import expand, input_place
from im_pnt.jobs import NO_LINEAGE, Activity, Job, Lineage
from im_pnt.ledger import Ledger
from im_pnt.net import Net, Role, Transition
from im_pnt.record import Record
from im_pnt.remote import encode_error
from im_pnt.tape import ends
from im_pnt.telling import Outlet, Teller, failure_of
from im_pnt.tokens import Tokens

_WAITING_ROLES = (Role.END, Role.FAILED, Role.CANCEL, Role.LOST, Role.GIVEN_UP, Role.WITHDRAWN)


class NetState:
    """The marking and the jobs of a net.

    Args:
        net: The net, as written.
        outlet: Takes tokens and replies for other nets.
        observer: Is told of firings.
        clock: Present time [s].

    Attributes:
        net: The expanded net.
        transitions: Its transitions, by number.
        number: Number of each transition.
        activities: Actions that run, by their numbers, in the order in which they began.
        tokens: The marking.
        enabling: What it enables.
        ledger: The jobs.
        readers: For each symbol the transitions that read it.
        teller: Tells of firings.
        outlet: Takes tokens and replies for other nets.
        clock: Present time [s].
        record: Takes what happens, before it does; None: no journal.
    """

    def __init__(self, net: Net, outlet: Outlet, observer: Observer, clock: Callable[[], float]) -> None:
        self.net = expand(net)
        self.record: Record | None = None
        self.outlet, self.clock = outlet, clock
        compiled = compile_net(self.net)
        self.transitions = tuple(self.net.transitions.values())
        self.number = {name: index for index, name in enumerate(compiled.transitions)}
        self.place = {name: index for index, name in enumerate(compiled.places)}
        free = [i for i, t in enumerate(self.transitions) if t.role not in _WAITING_ROLES]
        self.ledger = Ledger()
        initial = compiled.marking_vector(self.net.initial_marking())
        self.tokens = Tokens(compiled, free, initial, self.ledger.merge)
        self.enabling = self.tokens.enabling
        self.activities: dict[int, Activity] = {}
        self.teller = Teller(net.name, observer)
        self.readers: dict[str, list[int]] = {}
        for index in free:
            symbol = self.transitions[index].symbol
            if symbol:
                self.readers.setdefault(symbol, []).append(index)

    def put(self, place: str, count: int, lineage: Lineage) -> None:
        """Puts tokens on a place from outside."""
        if lineage is NO_LINEAGE and not self.tokens.queues:
            self.enabling.add(self.place[place], count)
        else:
            self.tokens.put(self.place[place], count, lineage)

    def write(self, job: Job) -> None:
        """Puts a job on the input tape."""
        self.ledger.add(job)
        self.ledger.tape.write(job)
        self.consider_readers(job.symbol)

    def close(self, job: Job, error: ImError | None) -> None:
        """Ends a job, and answers whoever asked for it."""
        was_open = self.ledger.is_open(job)
        self.ledger.close(job, error)
        if was_open and job.request is not None:
            self.outlet.send_reply(job.request, error, job.results)

    def _awaits_acceptance(self, job: Job) -> bool:
        if job.request is None or job.from_tape:
            return False
        waiting = self.tokens.queues.get(self.place[input_place(job.request.service)], ())
        return any(lineage.job is job for lineage in waiting)

    def forget(self, job: Job, error: ImError) -> None:
        """Ends a job that the net, come to rest, has forgotten."""
        if self.record is not None:
            self.record(["forgotten", job.number, encode_error(error)])
        self.close(job, error)

    def close_forgotten(self) -> None:
        """Ends the commands that a net at rest can acknowledge no more, so that no client waits in vain."""
        if not len(self.ledger) or self.activities or self.enabling.clocks:
            return
        begun = self.ledger.begun_commands()
        if not begun or any(place not in self.net.rest_places() for place in self.tokens.marking()):
            return
        for job in begun:
            text = f"net {self.net.name} came to rest and emitted neither {job.symbol}_done nor {job.symbol}_failed"
            error = job.last_failure or ImError(text, code="net", symbol=job.symbol)
            self.forget(job, error)

    def cancel(self, jobs: Iterable[Job], error: ImError) -> None:
        """Has jobs end early: those on the tape now, the others when what is done for them has ended."""
        for job in jobs:
            if self.ledger.tape.withdraw(job):
                self.close(job, error)
            else:
                job.cancelled = True
                job.unwanted = self._awaits_acceptance(job)
                job.last_failure = error

    def guard_broke(self, job: Job, error: ImError) -> None:
        """Keeps why a guard broke, as the last failure of its job."""
        if self.record is not None:
            self.record(["guard", job.number, encode_error(error)])
        job.last_failure = error

    def emit(self, transition: Transition, lineage: Lineage) -> None:
        """Writes to the output tape what a transition emits; that may end a job."""
        for emitted in transition.emit:
            self.teller.emitted(emitted, lineage)
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
