"""Interrupts woven into a net: places and transitions around the action, verified and run as all others.

A condition that ends an action early, and what is done then, are the execution rules of Petri Net Plans (L. Iocchi,
L. Jeanpierre, M. T. Lazaro and A.-I. Mouaddib, "A practical framework for robust decision-theoretic planning and
execution for service robots", ICAPS 2016).

Of a transition ``reach`` and the interrupt ``person``, ``reach.person.begin`` has the action and the watch begin
together. When the condition holds, ``reach.person.stop`` asks the action to end; when the action has ended by itself,
``reach.person.leave`` asks the watch to. Which of both came first tells how it goes on.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from im_core.text.yamltext import Kind, Value, find, mapping, scalar, sequence
from im_pnt.expression.errors import ExpressionError
from im_pnt.expression.syntax import ROOTS, Field, Name, Node, parse, rebuilt, shown
from im_pnt.expression.template import OPENS, written_pieces
from im_pnt.netfile.schema.interrupts import InterruptFile
from im_pnt.netfile.text import complaint

Pair = tuple[Value, Value]
_MESSAGE = "message"
_KEPT = {"keeps_failure": "true"}
_OWN = ("in", "out", "on_failure", "on_doubt", "symbol", "emit", "guard", "inhibitors", "resets", "cancels", "with")


@dataclass(frozen=True, slots=True)
class Interrupt:
    """Interrupt, as written."""

    name: str
    file: InterruptFile
    written: Value


class Weave:
    """Places and transitions that an interrupt makes around a transition.

    Args:
        interrupt: The interrupt.
        transition: Name of the transition.
        arcs: Its places, by ``in``, ``out`` and ``on_failure``.

    Attributes:
        inner: The places that it has instead.
        places: Names of the new places.
    """

    def __init__(self, interrupt: Interrupt, transition: str, arcs: Mapping[str, Value]) -> None:
        self._interrupt, self._of, self._arcs = interrupt, transition, arcs
        self._near = interrupt.written
        own = {kind: self._name(name) for kind, name in (("in", "ready"), ("out", "over"), ("on_failure", "missed"))}
        self.inner = {kind: scalar(name, self._near) for kind, name in own.items()}
        steps = [self._name(f"next_{rank}") for rank in range(1, len(interrupt.file.do) + 1)]
        waiting = [self._name("armed"), self._name("stopped")]
        kept = interrupt.file.then == "continue"
        watched = [self._name("seen"), self._name("blind")] if interrupt.file.watch is not None and not kept else []
        done = [self._name("done")] if interrupt.file.do and interrupt.file.then == "restart" else []
        self.places = [*own.values(), *waiting, *watched, *steps, *done]

    def transitions(self, actions: Sequence[str]) -> list[Pair]:
        """Return the new transitions.

        Args:
            actions: Names of the transitions with the actions that it ends.

        Raises:
            NetFileError: The condition, or something that is to be done, cannot be read.
        """
        file, name = self._interrupt.file, self._name
        wanted, done, failed = (self._arcs[kind] for kind in ("in", "out", "on_failure"))
        ready, over, missed = (self.inner[kind] for kind in ("in", "out", "on_failure"))
        armed, stopped = name("armed"), name("stopped")
        kept = file.then == "continue"
        targets: dict[str, Value | str] = {"restart": wanted, "skip": done, "fail": failed, "continue": stopped}
        target = targets[file.then]
        first = name("next_1") if file.do else target
        held = [armed]
        made: dict[str, Mapping[str, object]] = {"begin": {"in": [wanted], "out": [ready, armed]}}
        if file.watch is not None:
            held = [] if kept else [name("seen"), name("blind")]
            ends = [first, stopped] if kept else held
            watch = {"in": [armed], "await": self._watched(), "out": ends[:1], "on_failure": ends[1:]}
            delay = find(self._near, ("delay",)).value
            made["watch"] = watch if file.delay is None else {**watch, "delay": delay}
            for suffix, place in (("", over), ("_missed", missed)):
                made[f"leave{suffix}"] = {"in": [place], "out": [place], "cancels": name("watch"), **_KEPT}
        asked = {"guard": find(self._near, ("if",)).value} if file.watch is None else {}
        if file.watch is None and kept:
            made["see"] = {"in": [armed], "out": [first], **asked}
        title = file.says or self._interrupt.name
        for rank, action in enumerate(() if kept else actions):
            suffix = f"_{rank + 1}" if rank else ""
            stop = {"cancels": action, "title": title}
            made[f"stop{suffix}"] = {"in": held[:1], "out": [stopped], **asked, **stop}
            for blind in held[1:]:
                made[f"stop_blind{suffix}"] = {"in": [blind], "out": [blind], **stop}
        for place, ended, end in ((over, "end", done), (missed, "fail", failed)):
            waits = zip(("", "_blind"), held, strict=False)
            beside = [*waits, ("_stopped", stopped)] if kept or place is over else waits
            failing = {} if place is over else _KEPT
            made |= {f"{ended}{suffix}": {"in": [place, other], "out": [end], **failing} for suffix, other in beside}
        if not kept:
            failing = _KEPT if first is failed else {}
            made["interrupted"] = {"in": [missed, stopped], "guard": "not cancelled", "out": [first], **failing}
            made["give_up"] = {"in": [missed, stopped], "guard": "cancelled", "out": [failed], **_KEPT}
        made |= self._steps(target, stopped if kept else failed)
        return [(scalar(name(key), self._near), self._value(data)) for key, data in made.items()]

    def _steps(self, target: "Value | str", failed: "Value | str") -> dict[str, Mapping[str, object]]:
        """Return the transitions of the steps."""
        file = self._interrupt.file
        made: dict[str, Mapping[str, object]] = {}
        written = find(self._near, ("do",)).value
        steps = written.children if written.kind is Kind.LIST else (written,)
        if file.do and file.then == "restart":
            again = target = self._name("done")
            made["again"] = {"in": [again], "guard": "not cancelled", "out": [self._arcs["in"]]}
            made["give_up_again"] = {"in": [again], "guard": "cancelled", "out": [failed]}
        for rank, step in enumerate(steps if file.do else (), 1):
            if step.kind is not Kind.MAPPING:
                raise complaint(step, f"{step.shown()} is not a mapping (key: value) with an action, or a delay")
            for key, _ in step.pairs:
                if key.text in _OWN:
                    raise complaint(key, f"'{key.text}' of what an interrupt does follows from the interrupt")
            here = self._name(f"next_{rank}")
            keys: dict[str, object] = {key.text: child for key, child in step.pairs}
            end = self._name(f"next_{rank + 1}") if rank < len(steps) else target
            if isinstance(awaited := keys.get("await"), Value):
                keys["await"] = self._awaited(awaited, f"do_{rank}")
            acts = keys.keys() - {"delay", "title"}
            made[f"do_{rank}"] = {"in": [here], "out": [end], **({"on_failure": [failed]} if acts else {}), **keys}
            if not acts:
                made[f"give_up_{rank}"] = {"in": [here], "guard": "cancelled", "priority": "1", "out": [failed]}
        return made

    def _watched(self) -> dict[str, object]:
        keys = dict[str, object]((key.text, child) for key, child in find(self._near, ("watch",)).value.pairs)
        if self._interrupt.file.condition is not None:
            keys["until"] = self._condition(find(self._near, ("if",)).value, "watch")
        return keys

    def _awaited(self, value: Value, part: str) -> Value:
        """Return an await with its message as the answer to it."""
        pairs = ((key, self._condition(child, part) if key.text == "until" else child) for key, child in value.pairs)
        return mapping(pairs, value) if value.kind is Kind.MAPPING else value

    def _condition(self, value: Value, part: str) -> Value:
        """Return a condition on a message, as one on the answer to a transition."""

        def answered(node: Node) -> Node:
            return Field(Name("answers"), self._name(part)) if node == Name(_MESSAGE) else rebuilt(node, answered)

        try:
            parts = written_pieces(value.text)
            if len(parts) != 1 or not parts[0].startswith(OPENS):
                raise complaint(value, f"{value.shown()} is not a condition ${{...}}")
            node = answered(parse(parts[0][2:-1], (*ROOTS, _MESSAGE)))
        except ExpressionError as error:
            raise complaint(value, str(error)) from error
        return scalar(f"{OPENS}{shown(node)}}}", value)

    def _name(self, part: str) -> str:
        return f"{self._of}.{self._interrupt.name}.{part}"

    def _value(self, data: object) -> Value:
        """Return data, with values in it, as a value at the place of the interrupt."""
        if isinstance(data, Value):
            return data
        if isinstance(data, Mapping):
            pairs = ((scalar(str(key), self._near), self._value(child)) for key, child in data.items())
            return mapping(pairs, self._near)
        if isinstance(data, list):
            return sequence(map(self._value, data), self._near)
        return scalar(str(data), self._near, quoted=False)
