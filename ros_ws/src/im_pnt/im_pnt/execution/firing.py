"""Two-phase firing of a net (paper, section 6): tokens leave, the action runs, outputs are marked when it confirms.

What is here is deterministic: it is done again, in the same order, when a journal is replayed. What decides, waits or
calls foreign code is elsewhere.
"""

from collections.abc import Callable
from typing import NamedTuple

from im_core.errors import ImError
from im_pnt.action import RequestAction
from im_pnt.errors import NetError
from im_pnt.events import Observer, Phase
from im_pnt.expand import active_place, cancelling_place, doubt_place, input_place
from im_pnt.jobs import NO_LINEAGE, Activity, ActivityState, Lineage
from im_pnt.net import Net, RemotePlace, Role
from im_pnt.netstate import NetState
from im_pnt.record import Entry, changed_data, restore_data
from im_pnt.remote import encode_error
from im_pnt.telling import Outlet, failure_of

DOUBT_CODE = "in_doubt"
"""Code of the error of an action of which nobody can tell what became."""
_PHASE_PLACES = {
    ActivityState.ACTIVE: active_place,
    ActivityState.CANCELLING: cancelling_place,
    ActivityState.IN_DOUBT: doubt_place,
}


class Mover(NamedTuple):
    """A transition that only moves tokens: no action, no symbol, no part in a coordination structure.

    Attributes:
        name: Its name.
        entry: What a journal is told when it fires.
        inputs: Places that it takes tokens from, with their numbers.
        outputs: Places that it marks, likewise.
        remote: Places of other nets, likewise.
    """

    name: str
    entry: Entry
    inputs: tuple[tuple[int, int], ...]
    outputs: tuple[tuple[int, int], ...]
    remote: tuple[tuple[RemotePlace, int], ...]


class FiringRule(NetState):
    """What firing does to a net.

    Args:
        net: The net, as written.
        outlet: Takes tokens and replies for other nets.
        observer: Is told of firings.
        clock: Present time [s].
    """

    def __init__(self, net: Net, outlet: Outlet, observer: Observer, clock: Callable[[], float]) -> None:
        super().__init__(net, outlet, observer, clock)
        self._movers = [self._mover(index) for index in range(len(self.transitions))]

    def withdraw(self, name: str) -> None:
        """Moves the tokens of a data object that has lost its validity."""
        for place in self.net.places.values():
            if place.data_object == name and place.on_invalid:
                while self.enabling.tokens[self.place[place.name]]:
                    self.fire(self.number[f"{place.name}.withdrawn"])

    def fire(self, index: int) -> Activity | None:
        """Fires an enabled transition.

        Returns:
            The action that is now to begin, for ``t.start``.
        """
        mover = self._movers[index]
        if mover is not None and not self.tokens.queues and self.ledger.serving is None:
            moved, entry, inputs, outputs, targets = mover
            if self.record is not None:
                self.record(entry)
            enabling = self.enabling
            for place, count in inputs:
                enabling.take(place, count)
            for place, count in outputs:
                enabling.add(place, count)
            for target, count in targets:
                self.outlet.send_token(self.net.name, target, count)
            self.teller.fired(moved, Phase.END, NO_LINEAGE)
            return None
        transition = self.transitions[index]
        if self.record is not None:
            self.record(["fire", transition.name])
        if transition.role is Role.ACCEPT:
            self.ledger.serving = self.tokens.first(self.place[input_place(transition.origin)]).job
        lineage = self.tokens.take_inputs(index)
        symbol = transition.symbol or ""
        if symbol:
            lineage = Lineage(self.ledger.tape.read(symbol), lineage.failure)
            self.consider_readers(symbol)
        passed_on: ImError | None = None
        match transition.role:
            case Role.START:
                return self.begin(index, lineage, symbol)
            case Role.ACCEPT | Role.FINISH:
                lineage = Lineage(self.ledger.serving, None)
            case Role.FINISH_FAILED:
                passed_on = failure_of(self.ledger.serving, transition, lineage.failure)
                lineage = Lineage(self.ledger.serving, passed_on)
            case Role.RETURN if lineage.job is not None:
                self.close(lineage.job, lineage.failure)
            case Role.WITHDRAWN:
                name = self.net.places[transition.origin].data_object
                passed_on = ImError(f"data object {name} lost its validity", code="data", object=name)
                if lineage.job is not None:
                    lineage.job.last_failure = passed_on
        self._give(index, NO_LINEAGE if lineage.job is None and passed_on is None else Lineage(lineage.job, passed_on))
        message = str(lineage.failure) if lineage.failure is not None else ""
        symbol = symbol or (transition.emit[0] if transition.emit else "")
        self.teller.fired(transition.name, Phase.END, lineage, symbol=symbol, message=message)
        self.emit(transition, lineage)
        return None

    def _mover(self, index: int) -> Mover | None:
        transition, compiled = self.transitions[index], self.enabling.compiled
        if transition.role is not Role.PLAIN or transition.symbol is not None or transition.emit:
            return None
        name, remote = transition.name, tuple(transition.remote_outputs.items())
        return Mover(name, ["fire", name], tuple(compiled.inputs[index]), tuple(compiled.outputs[index]), remote)

    def begin(self, index: int, lineage: Lineage, symbol: str) -> Activity:
        """Marks ``t.active`` for tokens that were taken; returns the action that is to begin."""
        transition = self.transitions[index]
        self.enabling.add(self.place[active_place(transition.origin)], 1)
        self.teller.fired(transition.origin, Phase.START, lineage, symbol=symbol)
        activity = self.new_activity(index, self.teller.sequence, lineage)
        self.activities[activity.number] = activity
        return activity

    def new_activity(self, index: int, number: int, lineage: Lineage) -> Activity:
        """Returns what is known of an action when it begins."""
        transition, places = self.transitions[index], self.net.places
        assert transition.action is not None
        end = self.net.transitions[f"{transition.origin}.end"]
        objects = tuple(found for place in end.outputs if (found := places[place].data_object) is not None)
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
            self.record(["phase", activity.number, name, encode_error(error)])
        self._leave(activity)
        activity.state = state
        if activity.lineage.job is not None:
            activity.lineage.job.unwanted = False
        self.enabling.add(self.place[_PHASE_PLACES[state](activity.transition)], 1)
        if state is ActivityState.IN_DOUBT:
            activity.doubt, activity.doubted = error, self.clock()
        phase = Phase.DOUBT if state is ActivityState.IN_DOUBT else Phase.CANCEL
        duration = self.clock() - activity.began
        self.teller.fired(activity.transition, phase, activity.lineage, duration=duration, message=str(error))

    def end(self, activity: Activity, error: ImError | None, results: dict[str, object]) -> ImError | None:
        """Fires ``t.end``, ``t.failed`` or ``t.given_up`` of an activity.

        Args:
            activity: One of :attr:`activities`.
            error: Why it failed, None if it has confirmed; of code ``in_doubt`` where nobody can tell.
            results: Results of a request.

        Returns:
            Why it failed after all.
        """
        job, data = activity.lineage.job, None
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
            self.record(["end", activity.number, name, encode_error(error), data])
        self.apply_end(activity, name, error, results)
        return error

    def apply_end(self, activity: Activity, name: str, error: ImError | None, results: dict[str, object]) -> None:
        """Fires a transition that ends an activity."""
        del self.activities[activity.number]
        job, index = activity.lineage.job, self.number[name]
        if job is not None and error is not None:
            job.last_failure = error
        elif job is not None and isinstance(activity.action, RequestAction):
            job.replies[activity.transition] = results
        self._leave(activity)
        lineage = NO_LINEAGE if job is None and error is None else Lineage(job, error)
        self._give(index, lineage)
        transition = self.transitions[index]
        self.teller.fired(
            activity.transition,
            Phase.FAILED if error else Phase.END,
            lineage,
            symbol=transition.emit[0] if transition.emit else "",
            duration=self.clock() - activity.began,
            message=str(error) if error else "",
        )
        self.emit(transition, lineage)

    def _leave(self, activity: Activity) -> None:
        self.enabling.take(self.place[_PHASE_PLACES[activity.state](activity.transition)], 1)

    def _give(self, index: int, lineage: Lineage) -> None:
        self.tokens.give_outputs(index, lineage)
        for target, count in self.transitions[index].remote_outputs.items():
            self.outlet.send_token(self.net.name, target, count)
