"""A report as text for people: the verdict first."""

from collections.abc import Iterator

from im_pnt.analysis.report import Counterexample, Report

_WIDTH = 14
_NAMED = 12
_ENDS = 20
_SHOWN_FLOWS = 20


def readable(report: Report) -> str:
    """Returns a report as lines of text."""
    verdict = "verified" if report.ok else "REFUSED" if report.refusals else "NOT VERIFIED"
    lines = [f"{'+'.join(report.nets)}: {verdict}"]
    rows = [*_refusals(report), *_answers(report), *(("assumed", text) for text in report.assumptions)]
    last = ""
    for label, text in rows:
        lines.append(f"  {label if label != last else '':<{_WIDTH}}{text}")
        last = label
    lines.append(f"  {'time':<{_WIDTH}}{report.time_s:.3f} s")
    return "\n".join(lines)


def _refusals(report: Report) -> Iterator[tuple[str, str]]:
    for refusal in report.refusals:
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


def _answers(report: Report) -> Iterator[tuple[str, str]]:
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
        yield "  growing", _some(report.unbounded_places)
    count = "" if not report.deadlock_states else f", {report.deadlock_states} markings"
    yield "deadlock", told("has_deadlock", f"{'yes' if report.has_deadlock else 'no'}{count}")
    yield "live", told("live")
    yield "reversible", told("reversible")
    yield "returning", told("resources_return")
    yield "never enabled", told("never_enabled", _some(report.never_enabled or []))
    flows = report.p_semiflows or []
    for flow in flows[:_SHOWN_FLOWS]:
        yield "invariant", " + ".join(f"{weight} {place}" if weight > 1 else place for place, weight in flow.items())
    if len(flows) > _SHOWN_FLOWS:
        yield "invariant", f"and {len(flows) - _SHOWN_FLOWS} more (--json shows all)"


def _some(names: list[str]) -> str:
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return (", ".join(names[:_NAMED]) or "none") + more
