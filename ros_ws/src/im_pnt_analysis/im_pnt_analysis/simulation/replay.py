"""Playing a given firing sequence, for instance a counterexample, on the expanded and composed net."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from im_core.errors import ImError, nearest
from im_core.files import MEBIBYTE, FileError, read_text
from im_core.text.jsontext import JsonError, decode_json
from im_pnt.errors import NetError
from im_pnt.model.compiled import Compiled, compile_net
from im_pnt.model.net import Net
from im_pnt_analysis.composition.compose import compose
from im_pnt_analysis.guards.coverage import settled_choices

_LARGEST = 50 * MEBIBYTE
_SHOWN = 12


@dataclass(frozen=True, slots=True)
class FiringSequence:
    """Sequence to play.

    Attributes:
        sequence: Transitions to fire, by their names in the composition.
        repeat: Transitions that can be repeated after them for ever; played once.
        reason: What the sequence shows, empty if nobody said.
        nets: Names of the nets it is for, empty if nobody said.
        marking: The marked places at the end, after one repetition; None: nobody said.
    """

    sequence: tuple[str, ...]
    repeat: tuple[str, ...] = ()
    reason: str = ""
    nets: tuple[str, ...] = ()
    marking: dict[str, int] | None = None


@dataclass(frozen=True, slots=True)
class ReplayedFiring:
    """One firing of a replay.

    Attributes:
        number: Counts from 1; 0 is the initial marking.
        transition: What fired, empty for the initial marking.
        marking: The marked places afterwards.
        enabled: What could fire next.
    """

    number: int
    transition: str
    marking: dict[str, int]
    enabled: tuple[str, ...]


def read_firing_sequence(given: str) -> FiringSequence:
    """Read a sequence to play: ``a -> b -> c``, or a file with a counterexample in JSON or a transition a line.

    Raises:
        ImError: There is no such file, or it cannot be understood.
    """
    if "->" in given:
        return FiringSequence(_names(given.split("->")))
    try:
        text = read_text(given, _LARGEST)
    except FileError as error:
        raise ImError(f"cannot read the firing sequence '{given}': {error.sentence}", code="input") from error
    if not text.lstrip().startswith(("{", "[")):
        lines = (line.split("#")[0] for line in text.splitlines())
        return FiringSequence(_names(name for line in lines for name in line.split("->")))
    try:
        data = decode_json(text)
    except JsonError as error:
        raise ImError(f"{given}: {error.sentence}", code="input") from error
    if isinstance(data, list):
        data = {"sequence": data}
    return _firing_sequence(given, data if isinstance(data, dict) else {})


def _names(parts: Iterator[str] | Sequence[str]) -> tuple[str, ...]:
    return tuple(name for part in parts if (name := part.strip()))


def _firing_sequence(file: str, data: dict[str, object]) -> FiringSequence:
    lists: dict[str, tuple[str, ...]] = {}
    for key in ("sequence", "repeat", "nets"):
        value = data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            raise ImError(f"{file}: '{key}' must be a list of names", code="input")
        lists[key] = tuple(value)
    if "sequence" not in data:
        raise ImError(f"{file}: 'sequence' is missing; it is a list of transitions", code="input")
    repeat_from = data.get("repeat_from")
    if repeat_from is not None:
        if type(repeat_from) is not int or not 0 <= repeat_from <= len(lists["sequence"]) or lists["repeat"]:
            raise ImError(f"{file}: 'repeat_from' must be a position in 'sequence', and 'repeat' empty", code="input")
        lists["sequence"], lists["repeat"] = lists["sequence"][:repeat_from], lists["sequence"][repeat_from:]
    marking = data.get("marking")
    if marking is not None and not (isinstance(marking, dict) and all(type(n) is int for n in marking.values())):
        raise ImError(f"{file}: 'marking' must give places their number of tokens", code="input")
    return FiringSequence(lists["sequence"], lists["repeat"], str(data.get("reason", "")), lists["nets"], marking)


def replay(nets: Sequence[Net], firings: FiringSequence) -> Iterator[ReplayedFiring]:
    """Fire the transitions of a sequence one by one.

    Yields:
        The initial marking, then each firing.

    Raises:
        NetError: The sequence is for other nets, names a transition that does not exist or is not enabled, or ends in
            another marking than it says; the message names the step, the reason, and what is enabled.

    >>> [firing.marking for firing in replay([oven], FiringSequence(("load", "bake")))]
    [{'cold': 1}, {'full': 1}, {'hot': 1}]
    """
    names = tuple(net.name for net in nets)
    if firings.nets and sorted(firings.nets) != sorted(names):
        raise NetError(f"the sequence is for the nets {', '.join(firings.nets)}; {', '.join(names)} were given")
    flat = compose(nets).net
    if any(name not in flat.transitions for name in firings.sequence + firings.repeat):
        flat = compose([settled_choices(net) for net in nets]).net  # of a proof, which knows of choices
    compiled = compile_net(flat)
    vector = compiled.marking_vector(compiled.net.initial_marking())
    yield ReplayedFiring(0, "", compiled.marking(vector), _enabled(compiled, vector))
    number_of = {name: index for index, name in enumerate(compiled.transitions)}
    for number, name in enumerate(firings.sequence + firings.repeat, start=1):
        transition = number_of.get(name)
        if transition is None:
            raise NetError(
                f"step {number}: there is no transition '{name}'{nearest(name, number_of)}; {_offer(compiled, vector)}",
                step=number,
                transition=name,
            )
        if not compiled.enabled(vector, transition):
            raise NetError(
                f"step {number}: transition {name} is not enabled: {_lack(compiled, vector, transition)}; "
                f"{_offer(compiled, vector)}",
                step=number,
                transition=name,
            )
        vector = compiled.fire(vector, transition)
        yield ReplayedFiring(number, name, compiled.marking(vector), _enabled(compiled, vector))
    _compare(firings, compiled, vector)


def _compare(firings: FiringSequence, compiled: Compiled, vector: tuple[int, ...]) -> None:
    if firings.marking is None:
        return
    expected = {place: count for place, count in firings.marking.items() if count}
    reached = compiled.marking(vector)
    if expected != reached:
        places = [place for place in {**expected, **reached} if expected.get(place, 0) != reached.get(place, 0)]
        text = ", ".join(f"{p} holds {reached.get(p, 0)} and not {expected.get(p, 0)}" for p in places[:_SHOWN])
        raise NetError(f"the sequence ends in another marking than it says: {text}")


def _enabled(compiled: Compiled, vector: tuple[int, ...]) -> tuple[str, ...]:
    return tuple(name for index, name in enumerate(compiled.transitions) if compiled.enabled(vector, index))


def _offer(compiled: Compiled, vector: tuple[int, ...]) -> str:
    names = _enabled(compiled, vector)
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"enabled: {', '.join(names[:_SHOWN])}{more}" if names else "nothing is enabled"


def _lack(compiled: Compiled, vector: tuple[int, ...], transition: int) -> str:
    lacks = [
        f"place {compiled.places[place]} holds {vector[place]} of the {weight} tokens it needs"
        for place, weight in compiled.inputs[transition]
        if vector[place] < weight
    ]
    lacks += [
        f"place {compiled.places[place]} holds {vector[place]} tokens, and {weight} inhibit it"
        for place, weight in compiled.inhibitors[transition]
        if vector[place] >= weight
    ]
    return ", ".join(lacks)
