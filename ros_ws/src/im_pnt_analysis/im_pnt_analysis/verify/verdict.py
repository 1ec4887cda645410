"""The verdict on one net or several: permission to run, and the shortest firing sequence of a refusal.

Methods are tried from the cheap to the costly: semiflows; explicit search; linear programming and coverability where
no semiflow bounds the net; decision diagrams where the space is too large to list; stubborn sets where only the
deadlock is left.
"""

from collections.abc import Sequence
from dataclasses import replace

from im_core.clock import monotonic, thread_cpu
from im_pnt.model.net import Net
from im_pnt_analysis.search.growth import GrowthTest
from im_pnt_analysis.search.limits import SearchLimits
from im_pnt_analysis.search.packing import TooManyTokensError
from im_pnt_analysis.search.reachability import Search
from im_pnt_analysis.verify import counterexamples
from im_pnt_analysis.verify.answers import (
    REFUSED,
    answer_from_coverability,
    answer_from_diagrams,
    answer_from_part,
    answer_from_stubborn_sets,
    answer_from_whole,
    answer_holding,
    answer_rest,
    conserve,
    describe,
    refuse_endless,
    refuse_overflow,
    solve_bounds,
)
from im_pnt_analysis.verify.problem import Problem, problem_of
from im_pnt_analysis.verify.report import Progress, Report

_FIRST, _FEW, _MANY = 1_000, 20_000, 2_000_000
"""Markings after which search looks for growth, and lets other methods try: on nets of unknown bound, on any."""

_ROWS, ALL_ROWS = 400, 2_000
"""P-semiflows to look for where only the verdict is wanted, which needs no more than bounds, and where all are."""

_SHARE = 0.4
"""Part of the time left that a method may take when others wait."""


def verify(
    nets: Sequence[Net],
    limits: SearchLimits | None = None,
    *,
    structure: bool = False,
    holding: bool = True,
    progress: Progress = lambda text: None,
) -> Report:
    """Verify one net, or several joined over remote places and coordination structures.

    Args:
        nets: The nets.
        limits: Where the search gives up.
        structure: Whether T-semiflows, siphons and traps are wanted too; the verdict does not need them.
        holding: Whether to find out, too, if whoever acts on a resource holds it; not where nets stand for others.
        progress: Is told what goes on.

    Raises:
        NetError: The nets do not fit together.
    """
    begin, used = monotonic(), thread_cpu()
    limits = limits or SearchLimits()
    problem = problem_of(nets)
    report = Report([net.name for net in nets], assumptions=list(problem.composition.assumptions))
    _Verification(problem, report, limits, thread_cpu() + limits.seconds, progress).run(structure=structure)
    report.refusals = [problem.in_names(refusal) for refusal in report.refusals]
    if holding:
        answer_holding(report, nets, limits.seconds)
    else:
        report.answer("asked of all nets together", resources_held=True)
    report.decide()
    report.time_s, report.cpu_s = round(monotonic() - begin, 4), round(thread_cpu() - used, 4)
    return report


class _Verification:
    def __init__(
        self, problem: Problem, report: Report, limits: SearchLimits, deadline: float, progress: Progress
    ) -> None:
        self.problem, self.report, self.limits, self.deadline = problem, report, limits, deadline
        self.progress = progress

    def run(self, *, structure: bool) -> None:
        problem, report = self.problem, self.report
        self.progress("semiflows")
        proven = conserve(report, problem, self.deadline, ALL_ROWS if structure else _ROWS)
        if structure:
            self.progress("siphons and traps")
            describe(report, problem, self.deadline)
        else:
            names = ("t_semiflows", "siphons", "traps")
            report.leave("not asked", *names, *(f"{name}_complete" for name in names))
        try:
            search = Search(
                problem.compiled,
                problem.initial,
                proven,
                kinds=problem.kinds,
                progress=lambda count: self.progress(f"{count} markings found"),
            )
        except TooManyTokensError as error:
            self._without_search(str(error))
        else:
            self._with(search)

    def _with(self, search: Search) -> None:
        problem, report = self.problem, self.report
        if report.bounded is None:
            self._look_for_growth(search)
        if report.bounded is not False and not search.complete:
            self._search(search)
        if search.complete:
            self.progress(f"all {search.found.count} markings found; from where to where")
            if len(problem.nets) == 1:
                answer_rest(report, problem, search)
            answer_from_whole(report, problem, search, self.deadline)
        else:
            answer_from_part(report, problem, search, self.deadline)
        self._rest(search.stopped)

    def _without_search(self, reason: str) -> None:
        """Answer where a place holds too many tokens for a list of markings."""
        if self.report.bounded is None:
            solve_bounds(self.report, self.problem, self._later())
        if self.report.bounded is None:
            self._cover()
        if self.report.bounded:
            answer_from_diagrams(self.report, self.problem, reason, self._later())
        self._rest(reason)

    def _rest(self, reason: str) -> None:
        """Search for a deadlock at least, and give the reason of missing answers."""
        if self.report.has_deadlock is None and self.problem.closed:
            self.progress("stubborn sets")
            answer_from_stubborn_sets(self.report, self.problem, self.limits.states, self.deadline)
        if not self.report.refusals:
            refuse_overflow(self.report, self.problem)
            refuse_endless(self.report, self.problem)
        if self.report.refusals:
            self.report.leave(REFUSED, "resources_return")
        self.report.leave(reason if self.report.bounded is not False else "the net is unbounded")

    def _look_for_growth(self, search: Search) -> None:
        """Search a net without a bounding semiflow, and decide on the boundedness if possible."""
        report = self.report
        test = GrowthTest(search.found)
        later = self._later()
        for count in (_FIRST, _FEW, 4 * _FEW, 16 * _FEW, _MANY):
            self._some(search, count, later)
            if search.complete or self._grows(test, search):
                break
            if count == _FIRST:  # growth along a line is seen by now
                continue
            if count == _FEW:
                self.progress("bounds by linear programming")
                solve_bounds(report, self.problem, later)
            if report.bounded or self._over(search) or thread_cpu() > later:
                break
        if not report.bounded and not search.complete:
            self._cover()

    def _grows(self, test: GrowthTest, search: Search) -> bool:
        growth = test.look(self._later())
        if growth is None:
            return False
        search.stopped = "the net is unbounded"
        self.report.answer("a marking covers an earlier one of its path", bounded=False, safe=False)
        self.report.refuse(counterexamples.growth(search.found, growth))
        return True

    def _cover(self) -> None:
        from im_pnt_analysis.search.coverability import coverability

        self.progress("coverability")
        problem = self.problem
        answer_from_coverability(self.report, problem, coverability(problem.compiled, problem.initial, self._later()))

    def _search(self, search: Search) -> None:
        """List the markings of a possibly bounded net, or put the markings into a decision diagram."""
        self._some(search, _MANY, self._later())
        if not search.complete and not search.widening:
            search.run(self.limits, self._later())
        if not search.complete:
            self.progress("decision diagrams")
            answer_from_diagrams(self.report, self.problem, search.stopped, self._later())
            if self.report.states is None:
                search.run(self.limits, self._later())

    def _some(self, search: Search, states: int, deadline: float) -> None:
        search.run(replace(self.limits, states=min(states, self.limits.states)), deadline)

    def _over(self, search: Search) -> bool:
        return search.found.count > self.limits.states or thread_cpu() > self.deadline

    def _later(self) -> float:
        now = thread_cpu()
        return now + _SHARE * max(0.0, self.deadline - now)
