"""Two-phase firing and coordination structures made explicit (paper, section 6 and Figure 11).

A transition with an action hides its tokens while the action runs. In the expanded net they are seen: ``t.start``
takes the inputs and marks ``t.active``; ``t.end`` or ``t.failed`` takes that token and gives the outputs or the
``on_failure`` places. An action that is asked to end early moves its token to ``t.cancelling`` (``t.cancel``); one
that nobody knows about, to ``t.in_doubt`` (``t.lost``); from there it ends by ``t.end.cancelling``,
``t.failed.in_doubt`` and so on, or, where nobody can tell, by ``t.given_up`` to the ``on_doubt`` places. A
P-invariant of the expanded net therefore holds at every instant, whatever the outcome. Where the ``servers`` of a
transition are counted, ``t.start`` takes one from ``t.servers``, and each end gives it back.

A service ``s`` adds the places I.s, SI, O.s and SO of the paper's coordination structure: ``accept.s`` takes the
request and the input semaphore SI, ``t_f.s`` gives SI back and marks O.s, ``return.s`` answers the caller and gives SO
back. Where services share a ``done`` or ``failed`` place, ``serving.s`` tells whose end it is.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

from im_pnt.errors import NetError
from im_pnt.model.net import LARGEST, Arcs, Net, Place, Role, Service, Transition

MADE = {
    "start",
    "end",
    "failed",
    "cancel",
    "lost",
    "given_up",
    "active",
    "cancelling",
    "in_doubt",
    "servers",
    "withdrawn",
}
"""Last words of names that the expansion makes of a transition or a place."""

MADE_OF_SERVICES = {"accept", "return", "t_f", "serving", "I", "O"}
"""First words of names that it makes of a service."""

INPUT_SEMAPHORE = "SI"
OUTPUT_SEMAPHORE = "SO"


def active_place(transition: str) -> str:
    """Return the name of the place marked during the action of a transition."""
    return f"{transition}.active"


def cancelling_place(transition: str) -> str:
    """Return the name of the place marked during the winding down of a cancelled action."""
    return f"{transition}.cancelling"


def doubt_place(transition: str) -> str:
    """Return the name of the place marked during the doubt about an action."""
    return f"{transition}.in_doubt"


def servers_place(transition: str) -> str:
    """Return the name of the place that holds the idle servers of a transition."""
    return f"{transition}.servers"


def input_place(service: str) -> str:
    """Return the name of place I of a service."""
    return f"I.{service}"


def output_place(service: str) -> str:
    """Return the name of place O of a service."""
    return f"O.{service}"


def expand(net: Net) -> Net:
    """Make the phases of timed transitions and the coordination structures explicit.

    Returns:
        The expanded net; an expanded net is returned as it is.

    Raises:
        NetError: A transition with an action has neither ``on_failure`` nor a place to escalate to.
    """
    if any(transition.role is not Role.PLAIN for transition in net.transitions.values()):
        return net
    places = dict(net.places)
    transitions: dict[str, Transition] = {}
    for transition in net.transitions.values():
        for part in _phases(net, transition):
            transitions[part.name] = part
        if transition.action is not None:
            for phase in (active_place, cancelling_place, doubt_place):
                places[phase(transition.name)] = Place(phase(transition.name))
        for name in _servers(transition):
            places[name] = Place(name, tokens=transition.at_once, resource=True)
    for place in net.places.values():
        if place.on_invalid:
            withdrawn = _withdrawn(place)
            transitions[withdrawn.name] = withdrawn
    if net.services:
        places[INPUT_SEMAPHORE] = Place(INPUT_SEMAPHORE, tokens=net.at_once, resource=True)
        places[OUTPUT_SEMAPHORE] = Place(OUTPUT_SEMAPHORE, tokens=1, resource=True)
    ends = Counter(end for service in net.services.values() for end in {service.done, service.failed})
    for service in net.services.values():
        serving: dict[str, int] = {}
        if ends[service.done] > 1 or ends[service.failed] > 1:  # in a shared place a token does not say whom it answers
            serving = {f"serving.{service.name}": 1}
        places[input_place(service.name)] = Place(input_place(service.name), remote=True)
        places[output_place(service.name)] = Place(output_place(service.name))
        places.update((name, Place(name)) for name in serving)
        for part in _coordination(service, serving):
            transitions[part.name] = part
    rest = net.rest
    if rest is not None:  # what no author writes lies there
        semaphores = (INPUT_SEMAPHORE, OUTPUT_SEMAPHORE) if net.services else ()
        rest = (*rest, *semaphores, *(name for t in net.transitions.values() for name in _servers(t)))
    return replace(net, places=places, transitions=transitions, rest=rest)


def failure_arcs(net: Net, transition: Transition) -> Arcs:
    """Return the targets of a failed action's tokens.

    Raises:
        NetError: Nothing says where.
    """
    if transition.on_failure:
        return transition.on_failure
    if net.escalate is not None:
        return {net.escalate: 1}
    raise NetError(
        f"transition {transition.name} of net {net.name} has an action but no on_failure places, "
        "and the net has no escalate place",
        net=net.name,
        transition=transition.name,
    )


def _servers(transition: Transition) -> Arcs:
    """Return the place of a transition's idle servers, where they are counted, and the one that an action takes."""
    counted = transition.action is not None and transition.at_once < LARGEST
    return {servers_place(transition.name): 1} if counted else {}


def _phases(net: Net, transition: Transition) -> Iterator[Transition]:
    if transition.action is None:
        other = transition.cancels
        taken, given = ({}, {}) if other is None else ({active_place(other): 1}, {cancelling_place(other): 1})
        inputs, outputs = {**transition.inputs, **taken}, {**transition.outputs, **given}
        yield replace(transition, inputs=inputs, outputs=outputs, origin=transition.name)
        return
    name, servers = transition.name, _servers(transition)
    active, cancelling, in_doubt = ({phase(name): 1} for phase in (active_place, cancelling_place, doubt_place))
    yield replace(
        transition,
        name=f"{name}.start",
        inputs={**transition.inputs, **servers},
        outputs=active,
        remote_outputs={},
        emit=(),
        on_failure={},
        role=Role.START,
        origin=name,
    )
    failure = {**failure_arcs(net, transition), **servers}
    # a cancel or a doubt decides no outcome: the action may still end either way
    for suffix, inputs in (("", active), (".cancelling", cancelling), (".in_doubt", in_doubt)):
        yield Transition(
            name=f"{name}.end{suffix}",
            inputs=inputs,
            outputs={**transition.outputs, **servers},
            remote_outputs=transition.remote_outputs,
            emit=transition.emit,
            role=Role.END,
            origin=name,
            line=transition.line,
            file=transition.file,
        )
        yield _phase(transition, f"failed{suffix}", inputs, failure, Role.FAILED)
    yield _phase(transition, "cancel", active, cancelling, Role.CANCEL)
    yield _phase(transition, "lost", active, in_doubt, Role.LOST)
    yield _phase(transition, "lost.cancelling", cancelling, in_doubt, Role.LOST)
    if transition.on_doubt:
        yield _phase(transition, "given_up", in_doubt, {**transition.on_doubt, **servers}, Role.GIVEN_UP)


def _phase(transition: Transition, name: str, inputs: Arcs, outputs: Arcs, role: Role) -> Transition:
    return Transition(
        name=f"{transition.name}.{name}",
        inputs=inputs,
        outputs=outputs,
        role=role,
        origin=transition.name,
        line=transition.line,
        file=transition.file,
    )


def _withdrawn(place: Place) -> Transition:
    outputs: dict[str, int] = {}
    for name in place.on_invalid:
        outputs[name] = outputs.get(name, 0) + 1
    return Transition(
        name=f"{place.name}.withdrawn",
        inputs={place.name: 1},
        outputs=outputs,
        role=Role.WITHDRAWN,
        origin=place.name,
    )


def _coordination(service: Service, serving: Arcs) -> Iterator[Transition]:
    request, reply, name = input_place(service.name), output_place(service.name), service.name
    yield Transition(
        name=f"accept.{name}",
        inputs={request: 1, INPUT_SEMAPHORE: 1},
        outputs={service.entry: 1, **serving},
        role=Role.ACCEPT,
        origin=name,
    )
    for suffix, place, role in (("", service.done, Role.FINISH), (".failed", service.failed, Role.FINISH_FAILED)):
        yield Transition(
            name=f"t_f.{name}{suffix}",
            inputs={place: 1, OUTPUT_SEMAPHORE: 1, **serving},
            outputs={INPUT_SEMAPHORE: 1, reply: 1},
            role=role,
            origin=name,
        )
    yield Transition(
        name=f"return.{name}", inputs={reply: 1}, outputs={OUTPUT_SEMAPHORE: 1}, role=Role.RETURN, origin=name
    )
