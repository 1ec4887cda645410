"""Visits of a calibration to a stated accuracy: as many as the solver's covariance asks for, by information.

A visit is some looks at one pose: their noise is averaged, and costs no motion. Before a calibration is possible, poses
are chosen for the cameras as drawn; then for those calibrated so far.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_calibration import DegenerateDataError, InconsistentDataError, Observation, calibrate
from im_calibration.design import PoseDesign, predicted_problem, unknowns_as_drawn, unknowns_of
from im_cell.camera_model import nominal
from im_cell.robot import load_cell
from im_cell.rotations import matrix_of_quaternion
from im_cell.visit_order import leg_times, visit_order
from im_dispatcher.job import problem_of_light
from im_dispatcher.poses_file import PosesFile

#: Poses before the first calibration: with fewer it is too uncertain to choose the next pose by.
FIRST_POSES = 12
#: Looks of a visit, and what a visit takes besides the motion: the arm comes to rest, and is looked at [s].
LOOKS, REST_S, LOOK_S = 8, 0.45, 0.05

#: Noise of spots and positions until some are observed [px], [m].
SPOT_SD, POSITION_SD = 0.05, 1e-5

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NextVisits:
    """Where the arm goes next.

    Attributes:
        poses: Numbers of poses from 1, one a look; empty: nowhere.
        expected_m: Expected error of a triangulated point, RMS, of what is observed; None: not calibrated yet [m].
    """

    poses: tuple[int, ...]
    expected_m: float | None = None


def next_visits(
    file: PosesFile,
    cameras: Sequence[str],
    accuracy_m: float,
    observed: Mapping[int, Sequence[Observation]],
    coming: Sequence[int],
    barred: Sequence[int],
) -> NextVisits:
    """Return the next visits: none if the accuracy is reached, will be with the looks to come, or no pose is left.

    Args:
        file: The poses, in free order.
        cameras: Names of the cameras.
        accuracy_m: Expected error of a triangulated point at which to end, RMS over the workspace [m].
        observed: What was seen, by the number of the pose.
        coming: Numbers of the poses where looks are not evaluated yet, one a look, the arm's own last.
        barred: Numbers of poses that are not to be visited, or not again.
    """
    cell = load_cell()
    seen = [each for looks in observed.values() for each in looks]
    count, expected, covariance = len(file.poses), None, None
    unknowns = unknowns_as_drawn([nominal(cell.cameras[name]) for name in cameras], count)
    if len(observed) >= FIRST_POSES:
        try:
            calibration = calibrate(problem_of_light(cameras, seen))
        except (DegenerateDataError, InconsistentDataError):
            pass
        else:
            if calibration.success:
                unknowns, covariance = unknowns_of(calibration, count), calibration.covariance
                expected = 1e-3 * calibration.expected.triangulation_rms_mm
    everywhere = problem_of_light(cameras, [_unseen(file, k) for k in range(count)])
    noise = np.tile(SPOT_SD**2 * np.eye(2), (len(cameras), count, 1, 1))
    for c, name in enumerate(cameras):
        if spots := [each.spots[name].covariance for each in seen if name in each.spots]:
            noise[c] = np.median(spots, axis=0)
    predicted = predicted_problem(replace(everywhere, spot_covariances=noise), unknowns)
    design = PoseDesign(predicted, unknowns, covariance, LOOKS)
    if covariance is None:
        for number, looks in observed.items():
            design.add(number - 1, len(looks))
    for number in coming:
        design.add(number - 1, 1)
    if expected is not None and (1e-3 * design.expected_mm if coming else expected) <= accuracy_m:
        return NextVisits((), expected)
    gone = {*observed, *coming, *barred}
    here = cell.groups[file.group].home if not coming else file.poses[coming[-1] - 1].joints
    places = np.array([here, *(pose.joints for pose in file.poses)])
    times = leg_times(cell, list(cell.joints_of(file.group)), places)
    way = [0]  # where the arm is, then the numbers of the poses in the order of their visits
    for _ in range(max(1, FIRST_POSES - len({*observed, *coming}))):
        allowed = np.array([number not in {*gone, *way} for number in range(1, count + 1)])
        longer = np.array([times[a] + times[b] - times[a, b] for a, b in pairwise(way)] + [times[way[-1]]])[:, 1:]
        if (best := design.best(longer.min(axis=0) + REST_S + LOOKS * LOOK_S, allowed)) is None:
            break
        design.add(best, LOOKS)
        way.insert(int(longer[:, best].argmin()) + 1, best + 1)
    order = [way[rank] for rank in visit_order(times[np.ix_(way, way)])]
    return NextVisits(tuple(number for number in order[1:] for _ in range(LOOKS)), expected)


def accuracy_reached(solver: Mapping[str, Any], asked_m: float, visits: Sequence[int]) -> dict[str, object]:
    """Return for the report the accuracy asked for, the expected one, and a sentence about a miss.

    Args:
        solver: What the calibration reports.
        asked_m: Accuracy asked for [m].
        visits: Numbers of the poses, one a look.
    """
    asked, expected = 1e3 * asked_m, solver["expected_error"]["triangulation_mm"]
    reached = expected is not None and bool(solver["success"]) and expected <= asked
    told: dict[str, object] = {"asked_mm": asked, "expected_mm": expected, "reached": reached}
    told |= {"poses": len(set(visits)), "looks": len(visits)}
    if not reached:
        error = "no error is known" if expected is None else f"an error of {expected:.3f} mm is expected"
        told["message"] = f"{error}, {asked:g} mm was asked for: the poses have run out"
    return told


def _unseen(file: PosesFile, k: int) -> Observation:
    pose = file.poses[k]
    rotation = matrix_of_quaternion(pose.orientation_xyzw)
    return Observation(pose.name, np.array(pose.position_m), rotation, POSITION_SD**2 * np.eye(3), {})
