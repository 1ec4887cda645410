"""Explanation of all spots: the spots to believe and the resulting cameras, from several starts.

Chi-square gates lead to the nearest set of spots that is consistent with itself. With few poses an outlier that bent
the first fit can have honest spots rejected for good. So where there is little redundancy, fits of parts of the poses
are tried as well, and the set wins that explains most at the stated noise.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.chi_squared import chi2_limit
from im_calibration.estimation.gates import FALSE_ALARM, TRUSTED_SHARE, Gated, fit_with_gates
from im_calibration.estimation.residuals import projectable
from im_calibration.estimation.solve import robust_cost, robust_fit
from im_calibration.estimation.start import FLAT, core_extent, start
from im_calibration.estimation.unknowns import ParameterLayout, Unknowns
from im_calibration.problem.problem import CalibrationProblem

REDUNDANT_SPOTS = 25
"""Spots of a camera from which on the gates have not been seen to end in a wrong set."""

_PARTS, _MOST_PARTS = 6, 18
_PART = 0.67
_SEED = 1989
_UNLIKELY = 1e-3


def first_explanation(problem: CalibrationProblem, layout: ParameterLayout) -> Gated:
    """Return the gated fit from the start given by all poses.

    Args:
        problem: The observations, in canonical order if the result shall not depend on the order.
        layout: Places of the unknowns.

    Raises:
        DegenerateDataError: A camera has too few spots, or the positions lie on a line.
        InconsistentDataError: No camera explains the spots.
    """
    return fit_with_gates(robust_start(problem, layout), problem, layout)


def best_explanation(problem: CalibrationProblem, layout: ParameterLayout, first: Gated | None = None) -> Gated:
    """The fit with gates of the best start.

    Args:
        problem: The observations, in canonical order if the result shall not depend on the order.
        layout: Places of the unknowns.
        first: That of the start that all poses give, by :func:`first_explanation`; None: not known yet.

    Raises:
        DegenerateDataError: A camera has too few spots, or the positions lie on a line.
        InconsistentDataError: No camera explains the spots.
    """
    best = first or first_explanation(problem, layout)
    all_believed = np.array_equal(best.used, problem.detected) and plausible(best, problem, layout)
    if all_believed or best.used.sum(axis=1).min() >= REDUNDANT_SPOTS:
        return best
    few = len(problem.positions) < REDUNDANT_SPOTS
    least = unexplained(best, problem)
    for i, unknowns in enumerate(_starts_from_parts(problem, layout, best.fit.unknowns)):
        if i >= _PARTS and (not few or plausible(best, problem, layout)):
            break
        gated = fit_with_gates(unknowns, problem, layout)
        cost = unexplained(gated, problem)
        if cost < least:
            best, least = gated, cost
    return best


def unexplained(gated: Gated, problem: CalibrationProblem) -> float:
    """Return the chi-square of the believed spots, plus the gate for each disbelieved spot or whole pose."""
    seen, used = problem.detected.sum(axis=0), gated.used.sum(axis=0)
    whole = (used == 0) & (seen > 0)
    blamed = np.where(whole, 0, seen - used).sum()
    gates = chi2_limit(FALSE_ALARM, 2 * seen[whole]).sum() + blamed * chi2_limit(FALSE_ALARM, 2)
    return float(gated.fit.chi2 + gates) if np.isfinite(gated.fit.chi2) else float("inf")


def plausible(gated: Gated, problem: CalibrationProblem, layout: ParameterLayout) -> bool:
    """Check whether most spots are believed and explained by the noise; if not, a further search is worthwhile."""
    believed = np.all(gated.used.sum(axis=1) >= TRUSTED_SHARE * problem.detected.sum(axis=1))
    freedom = max(1, 2 * int(gated.used.sum()) - layout.free_size)
    return bool(believed and gated.fit.chi2 < chi2_limit(_UNLIKELY, freedom))


def robust_start(problem: CalibrationProblem, layout: ParameterLayout) -> Unknowns:
    """Return the robust fit from a linear start; with unknown offsets, refit from found ones and keep the better."""
    fits = [robust_fit(_held(start(problem, layout), problem), problem, layout, problem.detected)]
    if layout.led or layout.joints:
        again = start(problem, layout, fits[0].unknowns)
        fits.append(robust_fit(again, problem, layout, problem.detected))
    best = min(fits, key=lambda fit: robust_cost(fit.unknowns, problem, layout)).unknowns
    seen = problem.detected & projectable(best, problem)
    for camera, spots, fewest in zip(problem.camera_names, seen.sum(axis=1), problem.fewest_spots, strict=True):
        if spots < fewest:
            extent = core_extent(problem.positions)
            if extent[2] < FLAT * extent[0]:
                raise DegenerateDataError(
                    "Most LED positions lie in a plane, and no camera was found.",
                    "Vary the height of the poses.",
                    parameters=(f"{camera}.intrinsics", f"{camera}.pose"),
                    camera=camera,
                )
            raise InconsistentDataError(f"No camera explains where {camera} saw the LED.", camera=camera)
    return best


def _held(unknowns: Unknowns, problem: CalibrationProblem) -> Unknowns:
    """Return the unknowns with the first camera where it is held, and intrinsics as they are given."""
    if problem.placements is not None and problem.placements.held is not None:
        rotations, translations = unknowns.rotations.copy(), unknowns.translations.copy()
        rotations[0], translations[0] = np.eye(3), -problem.placements.held
        unknowns = replace(unknowns, rotations=rotations, translations=translations)
    if problem.given_intrinsics:
        intrinsics = unknowns.intrinsics.copy()
        for row, given in zip(intrinsics, problem.given_intrinsics, strict=True):
            if given is not None:
                row[: len(given.values)] = given.values
        unknowns = replace(unknowns, intrinsics=intrinsics)
    return unknowns


def _starts_from_parts(problem: CalibrationProblem, layout: ParameterLayout, offsets: Unknowns) -> Iterator[Unknowns]:
    """Robust fits of random parts of the poses; every other one from the offsets found before."""
    rng, n = np.random.default_rng(_SEED), len(problem.positions)
    for i in range(_MOST_PARTS):
        chosen = np.sort(rng.permutation(n)[: max(problem.fewest_spots.max(), round(_PART * n))])
        part = problem.taking(chosen)
        try:
            begin = start(part, (of_part := ParameterLayout.of(part)), offsets if i % 2 else None)
            unknowns = robust_fit(begin, part, of_part, part.detected).unknowns
        except (DegenerateDataError, InconsistentDataError):
            continue  # this part says nothing; the others may
        nowhere = np.zeros_like(problem.positions), np.zeros(layout.shared)
        unknowns = replace(unknowns, displacements=nowhere[0], shared_errors=nowhere[1])
        if np.all((problem.detected & projectable(unknowns, problem)).sum(axis=1) >= problem.fewest_spots):
            yield unknowns
