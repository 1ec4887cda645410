"""The answers about nets, each with the method or with the reason of the absence."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

from im_pnt.errors import VerificationError
from im_pnt.model.net import Net
from im_pnt.verification import KINDS, Counterexample
from im_pnt_analysis.composition.flat_net import NOT_LOOKED_AT

Progress = Callable[[str], None]
"""Is told now and then what goes on."""

_ONCE = KINDS[:3]

NOTHING_ACTS = "nothing in the files acts on a resource"
"""Why everybody holds what he acts on, in most nets."""


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
        resources_held: Whether whoever acts on a resource holds it.
        comes_to_rest: Whether a net, alone, is back in the first marking whenever it does nothing by itself.
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
        cpu_s: How much of the processor it took [s].
        proved_before: Whether this is the verdict of an earlier verification of the same nets.
        composed: The nets of the composition that refusals speak of; empty where nobody asked.

    >>> report.live, report.has_deadlock, report.methods["bounded"]
    (True, False, 'every place is in a P-semiflow')
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
    resources_held: bool | None = None
    comes_to_rest: bool | None = None
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
    cpu_s: float = 0.0
    proved_before: bool = False
    composed: list[Net] = field(default_factory=list, repr=False, compare=False)

    def answer(self, method: str, **answers: object) -> None:
        """Enter missing answers; None is no answer."""
        for name, value in answers.items():
            if value is not None and getattr(self, name) is None:
                setattr(self, name, value)
                self.methods[name] = method
                self.unknown.pop(name, None)

    def leave(self, reason: str, *names: str) -> None:
        """Enter the reason of missing answers.

        Args:
            reason: Why.
            names: Attributes; none: all that have no reason yet.
        """
        for name in names or [name for name in ANSWERS if name not in self.unknown]:
            if getattr(self, name) is None:
                self.unknown[name] = reason

    def refuse(self, counterexample: Counterexample) -> None:
        """Add a reason against running the nets; the first growth, overflow and deadlock is enough.

        What somebody assumed comes first, for the rest follows from it.
        """
        kind = counterexample.kind
        if kind == "assumption":
            self.refusals.insert(0, counterexample)
        elif kind not in _ONCE or all(refusal.kind != kind for refusal in self.refusals):
            self.refusals.append(counterexample)

    def decide(self) -> None:
        """Enter the verdict by the known answers."""
        safe = self.bounded is True and self.has_deadlock is False
        self.ok = safe and self.resources_return is True and self.resources_held is True and not self.refusals

    def to_dict(self) -> dict[str, object]:
        """Return the report as plain data."""
        return {name: value for name, value in asdict(replace(self, composed=[])).items() if name != "composed"}

    def require_ok(self) -> None:
        """Accept or refuse.

        Raises:
            VerificationError: The net must not run; carries the shortest firing sequence that shows why.
        """
        name = "+".join(self.nets)
        for refusal in self.refusals:
            raise VerificationError(name, refusal.reason, refusal.sequence + refusal.repeat)
        if not self.ok:
            raise VerificationError(name, self.unproved, proved=False)

    @property
    def unproved(self) -> str:
        """Reason of a missing decision; empty for a decided one."""
        if self.ok or self.refusals:
            return ""
        reasons: dict[str, list[str]] = {}
        for answer, question in NEEDED.items():
            if answer in self.unknown:
                reasons.setdefault(self.unknown[answer], []).append(question)
        return "; ".join(f"whether {' and '.join(questions)}: {why}" for why, questions in reasons.items())

    @property
    def sentence(self) -> str:
        """The verdict in one sentence."""
        if not self.ok:
            try:
                self.require_ok()
            except VerificationError as error:
                return error.message
        how = "is unchanged since it was verified" if self.proved_before else "verified"
        took = "" if self.proved_before else f" in {self.cpu_s:.3f} s of CPU time"
        return f"net {'+'.join(self.nets)} {how}: {self.states} markings{took}"


NEEDED = {
    "bounded": "no place grows without end",
    "has_deadlock": "it can get stuck",
    "resources_return": "commands and resources always come back",
    "resources_held": "everybody holds what he acts on",
}
"""Answers without which no net is accepted, and what they decide."""

_NO_ANSWERS = (
    "nets",
    "ok",
    "refusals",
    "assumptions",
    "methods",
    "unknown",
    "time_s",
    "cpu_s",
    "proved_before",
    "composed",
)
ANSWERS = tuple(name for name in Report.__slots__ if name not in _NO_ANSWERS)
"""Attributes of a report that are answers."""


_WIDTH = 14
_NAMED = 12
_ENDS = 20


def readable(report: Report, titles: Mapping[str, str], everything: bool = False) -> str:
    """Return a report as lines of text.

    Args:
        report: The report.
        titles: Names for people, by the names in the composition.
        everything: Print all refusals, invariants, assumptions and names, not only the verdict.
    """
    verdict = "verified" if report.ok else "REFUSED" if report.refusals else "NOT VERIFIED"
    lines = [f"{'+'.join(report.nets)}: {verdict}"]
    refusals = report.refusals if everything else report.refusals[:1]
    left_out = [text for text in report.assumptions if text.startswith(NOT_LOOKED_AT)]
    label = NOT_LOOKED_AT.rstrip(": ")
    rows = [*_refusals(refusals), *((label, text.removeprefix(NOT_LOOKED_AT)) for text in left_out)]
    rows += _answers(report, everything)
    if everything:
        rows += [("invariant", _sum(flow)) for flow in report.p_semiflows or []]
        rows += [("assumed", text) for text in report.assumptions if text not in left_out]
    if titles:
        rows.append(("called", _some([f"{name}: {title}" for name, title in titles.items()], everything)))
    if not everything and (more := _more(report, len(report.assumptions) - len(left_out))):
        rows.append(("left out", f"{more} (--all)"))
    last = ""
    for label, text in rows:
        lines.append(f"  {label if label != last else '':<{_WIDTH}}{text}")
        last = label
    lines.append(f"  {'time':<{_WIDTH}}{report.time_s:.3f} s")
    return "\n".join(lines)


def _more(report: Report, assumptions: int) -> str:
    counts = {
        "refusal": len(report.refusals) - 1,
        "invariant": len(report.p_semiflows or []),
        "assumption": assumptions,
    }
    return ", ".join(f"{count} {what}{'s' if count > 1 else ''}" for what, count in counts.items() if count > 0)


def _sum(flow: dict[str, int]) -> str:
    return " + ".join(f"{weight} {place}" if weight > 1 else place for place, weight in flow.items())


def refusal_text(report: Report) -> str:
    """Return the refusal of nets in lines, without the other answers."""
    names = ", ".join(report.nets)
    lines = [f"nets {names} are refused:" if len(report.nets) > 1 else f"net {names} is refused:"]
    lines += [f"  {label:<{_WIDTH}}{text}" for label, text in _refusals(report.refusals)]
    return "\n".join(lines)


def _refusals(refusals: Sequence[Counterexample]) -> Iterator[tuple[str, str]]:
    for refusal in refusals:
        yield "refused", refusal.reason
        yield from _way(refusal)


def _way(refusal: Counterexample) -> Iterator[tuple[str, str]]:
    yield "  after", _firings(refusal.sequence) or "(nothing)"
    if refusal.repeat:
        yield "  repeating", _firings(refusal.repeat)
    marking = ", ".join(f"{place}={count}" for place, count in refusal.marking.items())
    yield "  marking", marking or "(empty)"


def _firings(sequence: tuple[str, ...]) -> str:
    if len(sequence) <= 3 * _ENDS:
        return " -> ".join(sequence)
    left_out = f"({len(sequence) - 2 * _ENDS} firings more: --counterexample FILE)"
    return " -> ".join((*sequence[:_ENDS], left_out, *sequence[-_ENDS:]))


def _answers(report: Report, everything: bool) -> Iterator[tuple[str, str]]:
    def told(name: str, text: str | None = None) -> str:
        value = getattr(report, name)
        if value is None:
            return f"unknown: {report.unknown.get(name, 'not asked')}"
        answer = str(value) if not isinstance(value, bool) else "yes" if value else "no"
        return f"{text if text is not None else answer} ({report.methods[name]})"

    arcs = "" if report.labelled_arcs is None else f", {report.labelled_arcs} firings"
    yield "markings", told("states", f"{report.states}{arcs}")
    most = "" if report.max_token_in_place is None else f", at most {report.max_token_in_place} in a place"
    yield "bounded", told("bounded", f"{'yes' if report.bounded else 'no'}{most}")
    if report.unbounded_places:
        yield "  growing", _some(report.unbounded_places, everything)
    count = "" if not report.deadlock_states else f", {report.deadlock_states} markings"
    yield "deadlock", told("has_deadlock", f"{'yes' if report.has_deadlock else 'no'}{count}")
    if everything or report.live is not None:
        yield "live", told("live")
    if everything:
        yield "reversible", told("reversible")
    yield "returning", told("resources_return")
    if report.resources_held is not True or report.methods["resources_held"] != NOTHING_ACTS:
        yield "held", told("resources_held")
    if everything or report.never_enabled:
        yield "never enabled", told("never_enabled", _some(report.never_enabled or [], everything))


def _some(names: list[str], everything: bool) -> str:
    named = names if everything else names[:_NAMED]
    more = f" and {len(names) - _NAMED} more (--all)" if len(names) > len(named) else ""
    return (", ".join(named) or "none") + more
