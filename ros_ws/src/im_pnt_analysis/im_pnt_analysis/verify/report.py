"""The answers about nets, each with its method or with the reason why it is missing."""

from dataclasses import asdict, dataclass, field

from im_pnt.errors import VerificationError

KINDS = ("growth", "overflow", "deadlock", "lost_command", "held_resource")
"""Kinds of refusals."""
_ONCE = KINDS[:3]


@dataclass(frozen=True, slots=True)
class Counterexample:
    """What goes wrong, and the shortest way there.

    Attributes:
        kind: One of :data:`KINDS`.
        reason: One sentence.
        sequence: Transitions to fire from the initial marking, by their names in the composition.
        marking: Marked places where it goes wrong.
        repeat: Transitions that can be repeated for ever after the sequence (unbounded nets).
    """

    kind: str
    reason: str
    sequence: tuple[str, ...]
    marking: dict[str, int]
    repeat: tuple[str, ...] = ()


@dataclass(slots=True)
class Report:
    """Answers about a composition; None where one was not obtained, with the reason in ``unknown``.

    Attributes:
        nets: Names of the nets.
        ok: Whether the nets may run.
        states: Number of reachable markings.
        labelled_arcs: Number of pairs of a reachable marking and a transition enabled there.
        distinct_edges: Number of pairs of a reachable marking and one that a single firing makes of it.
        max_token_in_place: Most tokens a place ever holds.
        max_token_per_marking: Most tokens of a marking.
        place_bounds: Most tokens of each place; None for one that can grow without end.
        bounded: Whether no place can grow without end.
        unbounded_places: Those that can.
        safe: Whether no place ever holds two tokens.
        has_deadlock: Whether it can get stuck, resting and waiting for a symbol or request excepted.
        deadlock_states: Number of markings in which it is stuck.
        live: Whether every transition can always be enabled again.
        live_transitions: Number of transitions that can.
        quasi_live: Whether every transition can fire at all.
        reversible: Whether the initial marking can be reached from every reachable marking.
        resources_return: Whether commands and services that were possible can always become possible again, and, in
            nets that declare no rest, every place that was marked at first can always get its tokens back.
        terminal_sccs: Number of strongly connected sets of markings that are never left.
        never_enabled_transitions: Number of transitions that can never fire.
        never_enabled: Their names.
        p_semiflows: Weightings of places that never change.
        p_semiflows_complete: Whether these are all of minimal support.
        t_semiflows: Firing counts that lead from a marking back to it.
        t_semiflows_complete: Whether these are all of minimal support.
        siphons: Minimal sets of places that stay empty once they are.
        siphons_complete: Whether these are all.
        traps: Minimal sets of places that stay marked once they are.
        traps_complete: Whether these are all.
        refusals: What forbids to run the nets.
        assumptions: What the verdict takes for granted.
        methods: For each answer how it was obtained.
        unknown: For each answer that is missing the reason.
        time_s: How long it took [s].
    """

    nets: list[str]
    ok: bool = False
    states: int | None = None
    labelled_arcs: int | None = None
    distinct_edges: int | None = None
    max_token_in_place: int | None = None
    max_token_per_marking: int | None = None
    place_bounds: dict[str, int | None] | None = None
    bounded: bool | None = None
    unbounded_places: list[str] | None = None
    safe: bool | None = None
    has_deadlock: bool | None = None
    deadlock_states: int | None = None
    live: bool | None = None
    live_transitions: int | None = None
    quasi_live: bool | None = None
    reversible: bool | None = None
    resources_return: bool | None = None
    terminal_sccs: int | None = None
    never_enabled_transitions: int | None = None
    never_enabled: list[str] | None = None
    p_semiflows: list[dict[str, int]] | None = None
    p_semiflows_complete: bool | None = None
    t_semiflows: list[dict[str, int]] | None = None
    t_semiflows_complete: bool | None = None
    siphons: list[list[str]] | None = None
    siphons_complete: bool | None = None
    traps: list[list[str]] | None = None
    traps_complete: bool | None = None
    refusals: list[Counterexample] = field(default_factory=list)
    assumptions: list[str] = field(default_factory=list)
    methods: dict[str, str] = field(default_factory=dict)
    unknown: dict[str, str] = field(default_factory=dict)
    time_s: float = 0.0

    def answer(self, method: str, **answers: object) -> None:
        """Gives answers that are not given yet; None is no answer.

        Args:
            method: How they were obtained.
            answers: Values by attribute.
        """
        for name, value in answers.items():
            if value is not None and getattr(self, name) is None:
                setattr(self, name, value)
                self.methods[name] = method
                self.unknown.pop(name, None)

    def leave(self, reason: str, *names: str) -> None:
        """Says why answers are missing, for those that are.

        Args:
            reason: Why.
            names: Attributes; none: all that have no reason yet.
        """
        for name in names or [name for name in ANSWERS if name not in self.unknown]:
            if getattr(self, name) is None:
                self.unknown[name] = reason

    def refuse(self, counterexample: Counterexample) -> None:
        """Adds what forbids to run the nets; the first growth, overflow and deadlock is enough."""
        kind = counterexample.kind
        if kind not in _ONCE or all(refusal.kind != kind for refusal in self.refusals):
            self.refusals.append(counterexample)

    def decide(self) -> None:
        """Gives the verdict on what is known."""
        accepted = self.bounded is True and self.has_deadlock is False and self.resources_return is True
        self.ok = accepted and not self.refusals

    def to_dict(self) -> dict[str, object]:
        """Returns the report as plain data."""
        return asdict(self)

    def require_ok(self) -> None:
        """Accepts or refuses.

        Raises:
            VerificationError: The net must not run; carries the shortest firing sequence that shows why.
        """
        name = "+".join(self.nets)
        for refusal in self.refusals:
            raise VerificationError(name, refusal.reason, refusal.sequence + refusal.repeat)
        if not self.ok:
            missing = [answer for answer in NEEDED if answer in self.unknown]
            why = "; ".join(f"{answer} is unknown ({self.unknown[answer]})" for answer in missing)
            raise VerificationError(name, why)


NEEDED = ("bounded", "has_deadlock", "resources_return")
"""Answers without which no net is accepted."""

_NO_ANSWERS = ("nets", "ok", "refusals", "assumptions", "methods", "unknown", "time_s")
ANSWERS = tuple(name for name in Report.__slots__ if name not in _NO_ANSWERS)
"""Attributes of a report that are answers."""
