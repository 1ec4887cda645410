"""Requests between composed nets and the replies: services (paper, Figure 11), and commands on tapes (section 6).

A caller that waits for a given net has a token on ``t.pending`` from its request to its reply, which is a token on
``t.reply``. If it has a time-out and gives up, the token moves to ``t.abandoned``, where the late reply ends; until it
has come, ``t.patience`` keeps it from giving up once more.

A caller's command waits in ``t.on_tape``; a transition that reads its symbol may take it from there, which marks
``t.read``. The output symbol ``<symbol>_done`` or ``<symbol>_failed`` ends it. While a command of a caller is read, it
is what such an output symbol acknowledges; the tape is free besides: others may write the same symbol at any time.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from im_core.errors import nearest
from im_pnt.errors import NetError
from im_pnt.execution.jobs import ends
from im_pnt.model.action import RequestAction
from im_pnt.model.expand import cancelling_place, doubt_place, input_place
from im_pnt.model.net import Net, Place, Role, Transition
from im_pnt_analysis.composition.flat_net import NOT_LOOKED_AT, FlatNet


@dataclass(frozen=True, slots=True)
class Caller:
    """Transition with a request to another net: the qualified name, and whether a time-out may end the wait."""

    name: str
    gives_up: bool

    def endings(self) -> Iterator[tuple[str, str, str]]:
        """Yield for each way of waiting a suffix, the place of the wait, and the place marked by a reply."""
        yield "", f"{self.name}.pending", f"{self.name}.reply"
        if self.gives_up:
            yield " given up", f"{self.name}.abandoned", f"{self.name}.patience"


class TapeCommands:
    """Connections between writers of commands, and the readers and acknowledgers."""

    def __init__(self, flat: FlatNet) -> None:
        self._flat = flat
        self._callers: dict[str, list[tuple[str, Caller]]] = {}

    def expect(self, net: str, symbol: str, caller: Caller) -> None:
        """Note a caller of a symbol on the tape of a net."""
        self._callers.setdefault(net, []).append((symbol, caller))

    def write(self, net: str, caller: Caller) -> str:
        """Add the places of a command; return the place on the tape."""
        flat, on_tape = self._flat, f"{caller.name}.on_tape"
        flat.add_place(net, Place(on_tape))
        flat.add_place(net, Place(f"{caller.name}.read"))
        cancelling = cancelling_place(caller.name)
        for suffix, waiting, answered in caller.endings():
            kept = {} if suffix else {cancelling: 1}
            flat.add_transition(
                Transition(
                    f"withdraw({caller.name}{suffix})",
                    {on_tape: 1, waiting: 1, **kept},
                    {answered: 1, **kept},
                    role=Role.ENVIRONMENT,
                    origin=caller.name,
                )
            )
        return on_tape

    def served(self, net: Net, flat: Transition) -> Iterator[Transition]:
        """Return a transition in all ways to read and acknowledge commands of callers.

        Args:
            net: Its net.
            flat: The transition with qualified names.
        """
        callers = self._callers.get(net.name, [])
        yield from self._acknowledging(flat, callers)
        for symbol, caller in callers:
            if flat.symbol == symbol:
                reading = replace(
                    flat,
                    name=f"{flat.name}({caller.name})",
                    symbol=None,
                    inputs={**flat.inputs, f"{caller.name}.on_tape": 1},
                    outputs={**flat.outputs, f"{caller.name}.read": 1},
                )
                if any(ends(emitted, symbol) is not None for emitted in flat.emit):
                    for suffix, waiting, answered in caller.endings():
                        yield replace(
                            reading,
                            name=f"{reading.name}{suffix}",
                            inputs={**reading.inputs, waiting: 1},
                            outputs={**flat.outputs, answered: 1},
                        )
                else:
                    yield reading

    def _acknowledging(self, flat: Transition, callers: list[tuple[str, Caller]]) -> Iterator[Transition]:
        served = [c for symbol, c in callers if any(ends(e, symbol) is not None for e in flat.emit)]
        if flat.symbol is not None or not served:
            yield flat
            return
        reads = {f"{caller.name}.read": 1 for caller in served}
        yield replace(flat, inhibitors={**flat.inhibitors, **reads})
        for caller in served:
            for suffix, waiting, answered in caller.endings():
                yield replace(
                    flat,
                    name=f"{flat.name}({caller.name}{suffix})",
                    inputs={**flat.inputs, f"{caller.name}.read": 1, waiting: 1},
                    outputs={**flat.outputs, answered: 1},
                )


_IN_DOUBT = ".in_doubt"


class ServiceCalls:
    """Connections between asking transitions and answering services.

    Args:
        flat: The net that grows.
        promises: What is said when more requests of a service are made at once than its net assumes; grows too.

    Raises:
        NetError: A net is asked for a service that it does not offer.
    """

    def __init__(self, flat: FlatNet, promises: dict[str, str]) -> None:
        self._flat, self._promises = flat, promises
        self._callers: dict[tuple[str, str], list[Caller]] = {}
        self._commands = TapeCommands(flat)
        for net in flat.nets.values():
            if absent := sorted(net.partners() - flat.nets.keys()):
                flat.assume(f"{NOT_LOOKED_AT}{', '.join(absent)} (asked by {net.name})")
            for start in net.transitions.values():
                action = _request_of(start)
                if action is not None and start.role is Role.START and self._offered(net, start, action):
                    caller = Caller(flat.qualified(net.name, start.origin), start.timeout is not None)
                    if action.service in flat.nets[action.net].services:
                        self._callers.setdefault((action.net, action.service), []).append(caller)
                    else:
                        self._commands.expect(action.net, action.service, caller)

    def _offered(self, net: Net, start: Transition, action: RequestAction) -> bool:
        server = self._flat.nets.get(action.net)
        if server is None:
            self._flat.assume(f"{action} of net {net.name} is answered, either way")
            return False
        offered = [*server.services, *server.symbols()]
        if action.service not in offered:
            raise NetError(
                f"transition {start.origin} of net {net.name} asks for {action.net}.{action.service}, "
                f"which net {action.net} does not offer{nearest(action.service, offered)}"
            )
        return True

    def certain_places(self, net: Net) -> frozenset[str]:
        """Return the places in_doubt without tokens: requests to given nets have no time-out."""
        starts = (t for t in net.transitions.values() if t.role is Role.START and t.timeout is None)
        asking = (t for t in starts if (action := _request_of(t)) is not None and action.net in self._flat.nets)
        return frozenset(doubt_place(t.origin) for t in asking)

    def connected(self, net: Net, flat: Transition) -> Iterator[Transition]:
        """Return a transition, connected with the requests or answers.

        Args:
            net: Its net, expanded.
            flat: The transition with qualified names.
        """
        start = net.transitions.get(f"{flat.origin}.start")
        action = _request_of(start) if start is not None else None
        if flat.role is Role.RETURN:
            yield from self._returns(net, flat)
        elif start is None or action is None or flat.role is Role.PLAIN or action.net not in self._flat.nets:
            yield from self._commands.served(net, flat)
        else:
            for phase in self._phases(net, flat, start, action):
                yield from self._commands.served(net, phase)

    def _returns(self, net: Net, flat: Transition) -> Iterator[Transition]:
        """Send a reply to the waiting caller, or to the place without one."""
        callers = self._callers.get((net.name, flat.origin), [])
        for caller in callers:
            for suffix, waiting, answered in caller.endings():
                yield replace(
                    flat,
                    name=f"{flat.name}({caller.name}{suffix})",
                    inputs={**flat.inputs, waiting: 1, **self._at_once(net.name, flat.origin)},
                    outputs={**flat.outputs, answered: 1},
                )
        if not callers:
            yield replace(flat, outputs={**flat.outputs, self._generic_caller(net, flat.origin): 1})

    def _generic_caller(self, net: Net, service: str) -> str:
        flat = self._flat
        idle = flat.qualified(net.name, f"caller.{service}")
        most = _most_requests(net, service)
        if most is not None:
            flat.assume(f"other nets make at most {most} requests of {net.name}.{service} at once (assume)")
        flat.add_place(net.name, Place(idle, tokens=most or net.at_once))
        flat.rest.add(idle)
        request = {flat.qualified(net.name, input_place(service)): 1}
        call = flat.qualified(net.name, f"call.{service}")
        flat.add_environment(Transition(call, {idle: 1}, request, origin=service))
        return idle

    def _at_once(self, net: str, service: str) -> dict[str, int]:
        """Return the place counting the requests of a service, as an arc, where the net assumes a bound."""
        flat = self._flat
        most = _most_requests(flat.nets[net], service)
        if most is None:
            return {}
        count = flat.qualified(net, f"{service}.at_most")
        if count not in flat.places:
            flat.add_place(net, Place(count, capacity=most))
            flat.rest.add(count)
            self._promises[count] = (
                f"net {net} assumes at most {most} requests of {service} at once, and other nets bring it to {{tokens}}"
            )
        return {count: 1}

    def _phases(self, net: Net, flat: Transition, start: Transition, action: RequestAction) -> Iterator[Transition]:
        caller = Caller(self._flat.qualified(net.name, flat.origin), start.timeout is not None)
        doubtful = flat.role in (Role.LOST, Role.GIVEN_UP) or flat.name.endswith(_IN_DOUBT)
        if doubtful and not caller.gives_up:
            return
        match flat.role:
            case Role.START:
                yield self._asking(net, flat, action, caller)
            case Role.END | Role.FAILED:
                yield replace(flat, inputs={**flat.inputs, f"{caller.name}.reply": 1})
                if flat.role is Role.FAILED and doubtful and not start.on_doubt:
                    yield _given_up(replace(flat, name=f"{flat.name}(given up)"), caller)
            case Role.GIVEN_UP:
                yield _given_up(flat, caller)
            case _:
                yield flat

    def _asking(self, net: Net, flat: Transition, action: RequestAction, caller: Caller) -> Transition:
        whole = self._flat
        whole.add_place(net.name, Place(f"{caller.name}.pending"))
        whole.add_place(net.name, Place(f"{caller.name}.reply"))
        whole.assume(f"net {action.net} lives, or comes back, while net {net.name} waits for its reply")
        if caller.gives_up:
            whole.add_place(net.name, Place(f"{caller.name}.abandoned"))
            whole.add_place(net.name, Place(f"{caller.name}.patience", tokens=1))
            whole.rest.add(f"{caller.name}.patience")
            whole.assume(
                f"net {net.name} gives up {action} once more only when net {action.net} is done with the one given up "
                "before: else requests could pile up"
            )
        counted = {}
        if action.service in whole.nets[action.net].services:
            request = whole.underway(action.net, input_place(action.service))
            counted = self._at_once(action.net, action.service)
        else:
            request = self._commands.write(action.net, caller)
        return replace(flat, outputs={**flat.outputs, f"{caller.name}.pending": 1, request: 1, **counted})


def _most_requests(net: Net, service: str) -> int | None:
    return net.assume[service].at_most if service in net.assume else None


def _request_of(transition: Transition) -> RequestAction | None:
    return transition.action if isinstance(transition.action, RequestAction) else None


def _given_up(flat: Transition, caller: Caller) -> Transition:
    """Return the way of a caller without a reply, while the reply is still to come."""
    inputs = {**flat.inputs, f"{caller.name}.pending": 1, f"{caller.name}.patience": 1}
    return replace(flat, inputs=inputs, outputs={**flat.outputs, f"{caller.name}.abandoned": 1})
