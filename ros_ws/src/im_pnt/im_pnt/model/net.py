"""Places, transitions and the attributes: the net as written by the author.

The terms are those of Murata, "Petri Nets: Properties, Analysis and Applications" (Proc. IEEE 77(4), 1989), and of the
paper, section 6: tapes, enabling functions, actions, remote places, coordination structures.
"""

import enum
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from im_pnt.model.action import Action, RequestAction
from im_pnt.model.arguments import ArgumentSchema, CommandDeclaration
from im_pnt.model.delay import Delay

LARGEST = 2**31 - 1
"""Largest number of tokens, weight or priority: analysis packs markings."""

OTHERWISE = "otherwise"
"""Guard that holds where no other guard of the transitions at the same places does."""

_NOT = re.compile(r"not\s+")

Arcs = Mapping[str, int]
"""Place name to arc weight (>= 1)."""

Marking = Mapping[str, int]
"""Place name to number of tokens; a place that is not named holds none."""


class Mark(NamedTuple):
    """Place of a value in a file; ``note`` is added to complaints."""

    file: str
    line: int
    column: int
    note: str = ""


class RemotePlace(NamedTuple):
    """A place of another net, perhaps in another process (paper, Figure 9)."""

    net: str
    place: str

    def __str__(self) -> str:
        return f"{self.net}.{self.place}"


class ObjectScope(enum.StrEnum):
    """Scope of a data object: each command's own, or the machine's."""

    COMMAND = "command"
    GLOBAL = "global"


@dataclass(frozen=True, slots=True)
class Place:
    """A place.

    Attributes:
        name: Name, unique in the net.
        tokens: Tokens of the initial marking.
        capacity: Bound that verification proves; a net that can exceed it is refused. None: no bound stated.
        data_object: Data object whose existence and validity the place stands for; ``${arguments.NAME}`` in its name is
            the value of an argument of the command or request.
        on_invalid: Places to which its tokens go when the object loses its validity.
        remote: Whether transitions of other nets may mark it.
        resource: Whether its tokens belong to nobody; None: see :mod:`im_pnt.model.resources`.
        object_type: Type of the data object, ``package/msg/Type``; None: not said.
        object_scope: Whose the data object is.
        title: Name for people, beside its own; empty: its own.
    """

    name: str
    tokens: int = 0
    capacity: int | None = None
    data_object: str | None = None
    on_invalid: tuple[str, ...] = ()
    remote: bool = False
    resource: bool | None = None
    object_type: str | None = None
    object_scope: ObjectScope = ObjectScope.COMMAND
    title: str = ""


@dataclass(frozen=True, slots=True)
class Guard:
    """Enabling function by the registered name, or an expression ``${...}``; or the negation of either; or `otherwise`.

    Attributes:
        name: What it asks.
        negated: Whether it holds where the answer is false.
        unless: Of `otherwise`: the guards that must not hold.
    """

    name: str
    negated: bool = False
    unless: tuple["Guard", ...] = ()

    def __str__(self) -> str:
        return f"not {self.name}" if self.negated else self.name

    @classmethod
    def of(cls, text: str) -> "Guard":
        """Return a guard as written in a file: a name or an expression, with ``not`` before it or not."""
        name = text.strip()
        negated = _NOT.match(name)
        return cls(name[negated.end() :] if negated else name, negated is not None)


@dataclass(frozen=True, slots=True)
class Strategy:
    """Learned probability of success, as Beta counts (paper, section 2).

    Attributes:
        successes: Successes counted before the first run (alpha).
        failures: Failures counted before the first run (beta).
        decay: Factor on the counts of all contending strategies at each outcome, 0..1; 1 forgets nothing.
        context: Text with values of arguments; experience of one context is not used in another.
        name: Under which experience is kept, by several transitions that do the same; empty: of the transition.
    """

    successes: float = 1.0
    failures: float = 1.0
    decay: float = 1.0
    context: str = ""
    name: str = ""


class ReadFor(enum.StrEnum):
    """Owner of a symbol's reading."""

    COMMAND = "command"
    NOBODY = "nobody"


class Role(enum.Enum):
    """Role of a transition of an expanded net."""

    PLAIN = "plain"
    START = "start"
    END = "end"
    FAILED = "failed"
    CANCEL = "cancel"
    LOST = "lost"
    GIVEN_UP = "given_up"
    ACCEPT = "accept"
    FINISH = "finish"
    FINISH_FAILED = "finish_failed"
    RETURN = "return"
    WITHDRAWN = "withdrawn"
    ENVIRONMENT = "environment"


@dataclass(frozen=True, slots=True)
class Transition:
    """A transition.

    Attributes:
        name: Name, unique in the net.
        inputs: Tokens it takes.
        outputs: Tokens it gives when its action has confirmed.
        remote_outputs: Tokens it gives to places of other nets.
        inhibitors: It is disabled while the place holds that many tokens or more.
        resets: Places that it empties when it has taken its tokens.
        guard: Enabling function.
        symbol: Symbol it needs from the input tape.
        symbol_of: COMMAND: the symbol is a word to a command under way; NOBODY: it begins none; None: whichever fits.
        symbol_expires: Time that the symbol waits on the tape [s], 0: not when the net comes to rest; None: for ever.
        emit: Symbols it writes to the output tape when it ends.
        action: What is done between taking and giving.
        on_failure: Tokens it gives instead when the action fails.
        on_doubt: Tokens it gives when nobody can tell what became of its action; empty: it counts as failed.
        timeout: Wall time the action may take [s]; None: the runner's own limit, if any.
        delay: Time that the action takes, for analysis and simulation; of a transition without action, the time for
            which it must be enabled before it fires.
        success: Probability that the action succeeds, for analysis and simulation.
        weight: How often it is taken among contending transitions, relative to the others.
        strategy: Its probability of success is learned, and weighs in the choice; None: it is not.
        priority: Larger goes first among contending transitions.
        retry_of: Transition whose further try it is, and as whose answer its own counts; None: it is no further try.
        role: What it is in an expanded net.
        origin: Transition, service or place it was expanded from; its own name otherwise.
        line: Line of the file, 0 where it was made by a program.
        file: File of that line, where it is another than that of the net: an included one.
        result: Values that its command or request returns when it ends well, by name.
        store: Values of data objects that are put when it ends well, by name.
        marks: Where its values stand, by the keys that lead there.
        acts_on: Resources that its action acts on; ``${arguments.NAME}`` in them is an argument. None: not said.
        title: Name for people, beside its own; empty: its own.
        says: What its action does, as a verb with its object, for progress and failures; empty: not said.
        servers: How many of its tokens are worked on at once, :data:`LARGEST`: all; None: all with an action, one with
            a delay alone.
        cancels: Transition whose running action it asks to end early; it fires only while there is one. None: none.
        keeps_failure: Whether its output tokens carry the failure of its input tokens; a failure of its own action is
            told after that one.
    """

    name: str
    inputs: Arcs = field(default_factory=dict)
    outputs: Arcs = field(default_factory=dict)
    remote_outputs: Mapping[RemotePlace, int] = field(default_factory=dict)
    inhibitors: Arcs = field(default_factory=dict)
    guard: Guard | None = None
    symbol: str | None = None
    emit: tuple[str, ...] = ()
    action: Action | None = None
    on_failure: Arcs = field(default_factory=dict)
    on_doubt: Arcs = field(default_factory=dict)
    timeout: float | None = None
    delay: Delay | None = None
    success: float = 1.0
    weight: float = 1.0
    strategy: Strategy | None = None
    priority: int = 0
    symbol_of: ReadFor | None = None
    symbol_expires: float | None = None
    retry_of: str | None = None
    role: Role = Role.PLAIN
    origin: str = ""
    line: int = 0
    file: str = ""
    result: Mapping[str, object] = field(default_factory=dict)
    store: Mapping[str, object] = field(default_factory=dict)
    marks: Mapping[tuple[int | str, ...], Mark] = field(default_factory=dict, compare=False, repr=False)
    acts_on: tuple[str, ...] | None = None
    resets: tuple[str, ...] = ()
    title: str = ""
    says: str = ""
    servers: int | None = None
    cancels: str | None = None
    keeps_failure: bool = False

    @property
    def at_once(self) -> int:
        """How many of its tokens are worked on at once; :data:`LARGEST`: all."""
        return self.servers or (1 if self.action is None else LARGEST)


@dataclass(frozen=True, slots=True)
class Service:
    """Service of a net through a coordination structure.

    Attributes:
        name: Name by which callers ask for it.
        entry: Place marked when a request is accepted.
        done: Place that means success.
        failed: Place that means failure.
        arguments: What it takes; None: not said, anything.
        acts_on: Resources that it acts on, which who asks for it is to hold; ``${arguments.NAME}`` is an argument.
            None: not said, none.
    """

    name: str
    entry: str
    done: str
    failed: str
    arguments: ArgumentSchema | None = None
    acts_on: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class Assumption:
    """Assumption of a net on other nets, at a place or a service, one of both.

    Attributes:
        at_most: Most tokens that are under way to the place or in it, or most requests of the service, at once.
        returns: Place of another net: for each token that is sent there, one comes back in this place, and no other.
    """

    at_most: int | None = None
    returns: RemotePlace | None = None


@dataclass(frozen=True, slots=True)
class Net:
    """Net; as written, or expanded by :func:`im_pnt.model.expand.expand`.

    Attributes:
        name: Name by which other nets refer to it.
        places: Places by name, in the author's order.
        transitions: Transitions by name, in the author's order.
        services: Services it offers.
        escalate: Place for failures of transitions without ``on_failure``.
        rest: Places that may hold tokens while the net waits for a symbol or a request; None: those marked initially.
        description: One line for people.
        source: File it came from.
        commands: What is said of symbols that begin a command; one of which nothing is said takes anything.
        assume: What it takes for granted of other nets, by remote place or service.
        at_once: Requests that are served at once; others wait.
        former: Net of which it is a former version, which ends its commands; empty: it is none.

    >>> net.initial_marking(), net.symbols(), net.functions(), net.partners()
    ({'cold': 1}, ('bake',), frozenset({'heat'}), frozenset())
    """

    name: str
    places: Mapping[str, Place]
    transitions: Mapping[str, Transition]
    services: Mapping[str, Service] = field(default_factory=dict)
    escalate: str | None = None
    rest: tuple[str, ...] | None = None
    description: str = ""
    source: str = ""
    commands: Mapping[str, CommandDeclaration] = field(default_factory=dict)
    assume: Mapping[str, Assumption] = field(default_factory=dict)
    at_once: int = 1
    former: str = ""

    def place_of(self, transition: Transition) -> str:
        """Return file and line of a transition, as messages begin; empty where it was made by a program."""
        return f"{transition.file or self.source}:{transition.line}: " if transition.line else ""

    def initial_marking(self) -> dict[str, int]:
        """Return the tokens of the marked places."""
        return {place.name: place.tokens for place in self.places.values() if place.tokens}

    def rest_places(self) -> frozenset[str]:
        """Return the places with tokens allowed at rest."""
        if self.rest is not None:
            return frozenset(self.rest)
        return frozenset(place.name for place in self.places.values() if place.tokens)

    def symbols(self) -> tuple[str, ...]:
        """Return the input symbols of the net, in order of first use."""
        return tuple(dict.fromkeys(t.symbol for t in self.transitions.values() if t.symbol))

    def begun_symbols(self) -> tuple[str, ...]:
        """Return the input symbols with a command to begin; others are words to open commands, or free."""
        transitions = self.transitions.values()
        return tuple(dict.fromkeys(t.symbol for t in transitions if t.symbol and t.symbol_of is None))

    def arguments_of(self, asked: str) -> ArgumentSchema | None:
        """Return the arguments of a service, or of a command's symbol; None: anything."""
        if asked in self.services:
            return self.services[asked].arguments
        return self.commands[asked].arguments if asked in self.commands else None

    def guards(self) -> frozenset[str]:
        """Return the names of the enabling functions used."""
        return frozenset(t.guard.name for t in self.transitions.values() if t.guard)

    def functions(self) -> frozenset[str]:
        """Return the names of the registered functions of actions, builders and handlers included."""
        return frozenset(name for t in self.transitions.values() if t.action for name in t.action.functions)

    def partners(self) -> frozenset[str]:
        """Return the receivers of the net's tokens and requests."""
        nets = {remote.net for t in self.transitions.values() for remote in t.remote_outputs}
        nets.update(t.action.net for t in self.transitions.values() if isinstance(t.action, RequestAction))
        return frozenset(nets)
