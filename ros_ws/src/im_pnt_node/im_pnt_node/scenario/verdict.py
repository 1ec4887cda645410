"""Verdict on scenarios: a run against the expectations, and the shortest failure of drawn runs."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from random import Random

import yaml

from im_pnt.expression.types import MessageTypes
from im_pnt.model.net import Guard
from im_pnt_node.scenario.draws import Draws, ValueDraw, shrink
from im_pnt_node.scenario.file import Scenario, ScenarioSet, StepFile, split_name
from im_pnt_node.scenario.report import Coverage, ScenarioOrder, ScenarioReport
from im_pnt_node.scenario.run import MOST_FIRINGS, ScenarioRunner

_SHOWN = 30
_NEAR_S = 1e-6


@dataclass(frozen=True)
class ScenarioVerdict:
    """Verdict on a scenario.

    Attributes:
        complaints: What was not as expected; empty: it has passed.
        outcome: The run, of several the one that failed, or the last.
        runs: How many runs there were.
        drawn: Whether answers were drawn.
    """

    complaints: tuple[str, ...]
    outcome: ScenarioReport
    runs: int = 1
    drawn: bool = False

    def told(self, where: str) -> str:
        """Return the complaints, the drawn values, and the firings."""
        lines = [f"{where}: {each}" for each in self.complaints]
        if self.drawn and self.complaints:
            script = {key: part for key, part in asdict(self.outcome.script).items() if part}
            drawn = yaml.safe_dump(script, sort_keys=False, default_flow_style=None, width=110)
            lines.append(f"the shortest of the failures found, in run {self.runs}, as a scenario:")
            lines += [f"    {line}" for line in drawn.splitlines()]
        lines += [f"told: {text}" for text in self.outcome.troubles]
        return "\n".join([*lines, "fired:", *_fired_lines(self.outcome)])


def _fired_lines(outcome: ScenarioReport) -> list[str]:
    """Return the firings of a run, a line each; of many the last."""
    several = len(outcome.marking) > 1
    lines = [f"{time:12.3f}  {f'{net}.' if several else ''}{text}" for time, net, text in outcome.firings]
    more = len(lines) - _SHOWN
    return lines if more <= 0 else [f"{'':12}  {more} before", *lines[-_SHOWN:]]


def judge(
    scenarios: ScenarioSet, scenario: Scenario, coverage: Coverage, types: MessageTypes, seed: int = 0
) -> ScenarioVerdict:
    """Run a scenario, with drawn answers as often as it says, and judge it."""
    values = ValueDraw(scenarios.nets, types)

    def tried(draws: Draws | None, reached: Coverage) -> tuple[tuple[str, ...], ScenarioReport]:
        outcome = ScenarioRunner(scenarios, scenario, values, reached, draws).run()
        return tuple(_complaints(scenarios, scenario, outcome)), outcome

    if scenario.content.random is None:
        return ScenarioVerdict(*tried(None, coverage))
    for number in range(1, scenario.content.random + 1):
        draws = Draws(dice=Random(f"{seed}:{number}"))
        complaints, outcome = tried(draws, coverage)
        if complaints:
            least = shrink(draws.taken, lambda given: _failing(Draws(given), tried))
            return ScenarioVerdict(*tried(Draws(least), Coverage()), number, drawn=True)
    return ScenarioVerdict((), outcome, number, drawn=True)


def _failing(
    draws: Draws, tried: Callable[[Draws, Coverage], tuple[tuple[str, ...], ScenarioReport]]
) -> Sequence[int] | None:
    complaints, _ = tried(draws, Coverage())
    return draws.taken if complaints else None


def _complaints(scenarios: ScenarioSet, scenario: Scenario, outcome: ScenarioReport) -> Iterable[str]:
    content, expected = scenario.content, scenario.content.expect
    if outcome.endless:
        yield f"it does not end: {MOST_FIRINGS} firings in {outcome.time:g} s"
        return
    for number in outcome.not_begun:
        yield f"step {number} was not taken: {content.steps[number - 1].during} did not begin"
    begun = {symbol for net in scenarios.nets for symbol in net.begun_symbols()}
    for number, order in outcome.orders.items():
        step = content.steps[number - 1]
        if step.symbol is not None and order.name not in begun and step.ends is None:
            continue  # a word to a command: what it does is seen there
        for text in _order_complaints(step, order, drawn=content.random is not None):
            yield f"step {number}, {order.name}: {text}"
    fired = [(net, text) for _, net, text in outcome.firings]
    at = 0
    for text in expected.order:
        net, name = split_name(text, scenarios.nets)
        found = next((rank for rank in range(at, len(fired)) if _is(fired[rank], net, name)), None)
        if found is None:
            before = "" if at == 0 else f" after {fired[at - 1][1]} (firing {at})"
            yield f"expect.order: {text} did not come{before}"
            break
        at = found + 1
    for text in expected.never:
        net, name = split_name(text, scenarios.nets)
        if any(_is(each, net, name) for each in fired):
            yield f"expect.never: {text} came"
    for place, count in expected.marking.items():
        net, name = split_name(place, scenarios.nets)
        held = sum(marking.get(name, 0) for each, marking in outcome.marking.items() if net in ("", each))
        if held != count:
            yield f"expect.marking: {place} holds {held}, not {count}"
    if expected.time is not None and not _between(outcome.time, expected.time):
        yield f"expect.time: it ended at {outcome.time:g} s, not {_told(expected.time)}"
    opened = any(step.ends in ("open", "waiting") for step in content.steps)
    if expected.rest and not opened:
        yield from (f"expect.rest: {text}" for text in outcome.unrest)


def _order_complaints(step: StepFile, order: ScenarioOrder, *, drawn: bool) -> Iterable[str]:
    result = order.result
    took = None if order.ended is None else order.ended - order.began
    ended = "open" if result is None else "done" if result.success else "failed"
    if result is None and order.job is not None and order.job.waiting:
        ended = "waiting"
    elif result is not None and result.error is not None and result.error.code == "cancelled":
        ended = "cancelled"
    wanted = step.ends or (None if drawn else "done")
    why = f" ({result.error.message})" if result is not None and result.error is not None else ""
    if wanted is None and ended == "open":
        yield "it has not ended"
    elif wanted is not None and ended != wanted:
        yield f"it is {ended}{why}, not {wanted}"
    if step.reason is not None and step.reason not in why:
        yield f"the reason is{why or ' none'}, without '{step.reason}'"
    if result is not None:
        yield from _differences("results", step.results, result.results)
    if step.takes is not None and took is not None and not _between(took, step.takes):
        yield f"it took {took:g} s, not {_told(step.takes)}"


def _is(fired: tuple[str, str], net: str, text: str) -> bool:
    return fired[1] == text and net in ("", fired[0])


def _differences(where: str, wanted: Mapping[str, object], found: Mapping[str, object]) -> Iterable[str]:
    for name, value in wanted.items():
        if name not in found:
            yield f"{where}: there is no {name}"
        elif isinstance(value, dict) and isinstance(below := found[name], dict):
            yield from _differences(f"{where}.{name}", value, below)
        elif found[name] != value:
            yield f"{where}.{name} is {found[name]!r:.80}, not {value!r:.80}"


def _between(value: float, times: tuple[float, float]) -> bool:
    return times[0] - _NEAR_S <= value <= times[1] + _NEAR_S


def _told(times: tuple[float, float]) -> str:
    return f"{times[0]:g} s" if times[0] == times[1] else f"{times[0]:g} to {times[1]:g} s"


def unreached(scenarios: ScenarioSet, coverage: Coverage) -> tuple[int, int, list[str]]:
    """Return how many transitions and sides of guards were reached, of how many, and the others in words."""
    total, left = 0, []
    for net in scenarios.nets:
        total += len(net.transitions) + 2 * len(net.guards())
        fired = coverage.transitions[net.name]
        left += [
            f"{net.place_of(each)}{name} never fired" for name, each in net.transitions.items() if name not in fired
        ]
        for name in sorted(net.guards()):
            where = next(net.place_of(t) for t in net.transitions.values() if t.guard and t.guard.name == name)
            sides = {True, False} - coverage.guards[net.name, name]
            left += [f"{where}guard {Guard(name)} was never {str(side).lower()}" for side in sorted(sides)]
    return total - len(left), total, left
