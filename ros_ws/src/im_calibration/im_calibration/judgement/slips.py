"""Common slips in data sets: units, axes, order of quaternions and Euler angles, inverses, pairing, mirror images.

Each slip is undone: the data are changed to what they would be without it. Whether that is so, a fit has to show.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.problem import CalibrationProblem
from im_calibration.turn_slips import mirrored_axes, turn_slips, turned_axes

Array = NDArray[np.float64]

_MIRROR = np.diag([1.0, 1.0, -1.0])
_SHIFTS = ((1, "before"), (-1, "after"))
_WORKSPACE_M = (0.02, 20.0)
"""What the positions of an arm extend over [m]: in a wrong unit, any spots fit positions that are all but one."""


@dataclass(frozen=True)
class Slip:
    """A slip, and the data without it.

    Attributes:
        sentence: What is wrong and how it was undone; what this gives is to follow.
        problem: The observations without the slip.
        mirror: Whether it is a mirror image: which one, cameras without any wrist cannot tell.
    """

    sentence: str
    problem: CalibrationProblem
    mirror: bool = False


def slips_of(problem: CalibrationProblem) -> Iterator[Slip]:
    """Yield the slips that concern all cameras alike.

    Args:
        problem: The observations, in the order in which they were made.
    """
    sentence = "The positions are mirrored, or all images are: with one axis reversed, or two exchanged,"
    yield Slip(sentence, _with_axes(problem, _MIRROR), mirror=True)
    least, most = _WORKSPACE_M
    extent = float(np.linalg.norm(np.ptp(problem.positions, axis=0)))
    for factor, units in ((1e-3, "millimetres"), (1e3, "kilometres")):
        if least < factor * extent < most:
            yield Slip(f"The positions are not in metres: as {units}", _scaled(problem, factor))
    inverses = np.swapaxes(problem.wrist_rotations, 1, 2)
    origins = -(inverses @ problem.positions[..., None])[..., 0]
    inverted = replace(problem, positions=origins, wrist_rotations=inverses)
    yield Slip("The poses are inverted (base in the wrist's frame): with their inverses", inverted)
    for shift, where in _SHIFTS:
        text = f"The spots are those of the pose {where}: shifted by one"
        yield Slip(text, _shifted(problem, shift, range(len(problem.camera_names))))
    if problem.led_offset_prior_sd > 0.0:  # else the wrist's rotations do not matter
        yield from _slips_of_wrists(problem)
        yield from _slips_of_axes(problem)


def slips_of_cameras(problem: CalibrationProblem, cameras: list[int]) -> Iterator[Slip]:
    """Yield the slips that concern some cameras, given by their indices."""
    names = ", ".join(problem.camera_names[c] for c in cameras)
    spots = problem.spots.copy()
    for c in cameras:
        spots[c, :, 0] = problem.image_sizes[c][0] - 1.0 - spots[c, :, 0]
    yield Slip(f"The images of {names} are mirrored: with one coordinate reversed", replace(problem, spots=spots))
    for shift, where in _SHIFTS:
        text = f"The spots of {names} are those of the pose {where}: shifted by one"
        yield Slip(text, _shifted(problem, shift, cameras))


def _slips_of_wrists(problem: CalibrationProblem) -> Iterator[Slip]:
    """Yield wrist rotations that were read wrongly; they show in the LED's offset alone."""
    given = problem.wrist_rotations
    text = "The wrist's rotations are the wrong way round: with their inverses (wrist -> base)"
    yield Slip(text, _with_wrists(problem, np.swapaxes(given, 1, 2)))
    for slip in turn_slips(given):
        how = "in their own order" if slip.numbers == "quaternions" else "so turned"
        text = f"The wrist's {slip.numbers} are {slip.own} and were read as {slip.read}: {how}"
        yield Slip(text, _with_wrists(problem, slip.turns))
    for shift, where in _SHIFTS:
        text = f"The wrist's rotations are those of the pose {where}: shifted by one"
        yield Slip(text, _with_wrists(problem, np.roll(given, -shift, axis=0)))


def _slips_of_axes(problem: CalibrationProblem) -> Iterator[Slip]:
    """Yield positions with other axes than the wrist's rotations."""
    axes_of = [(*each, True) for each in mirrored_axes()] + [(*each, False) for each in turned_axes()]
    for phrase, axes, mirror in axes_of:
        what = "are mirrored" if mirror else "have other axes than the wrist's rotations"
        changed = replace(problem, positions=problem.positions @ axes.T, joint_offset_prior_sd=0.0)
        yield Slip(f"The positions {what}: with {phrase}", changed, mirror)


def _with_wrists(problem: CalibrationProblem, rotations: Array) -> CalibrationProblem:
    """Return the problem with other wrist rotations; the positions hold the nominal offset, turned by the old ones."""
    moved = (rotations - problem.wrist_rotations) @ np.array(problem.led_offset_nominal)
    return replace(problem, positions=problem.positions + moved, wrist_rotations=rotations)


def _shifted(problem: CalibrationProblem, shift: int, cameras: list[int] | range) -> CalibrationProblem:
    """Return the problem with the spots of some cameras paired with the poses ``shift`` places earlier."""
    spots, noise = problem.spots.copy(), problem.spot_covariances.copy()
    for c in cameras:
        spots[c], noise[c] = np.roll(spots[c], -shift, axis=0), np.roll(noise[c], -shift, axis=0)
    return replace(problem, spots=spots, spot_covariances=noise)


def _scaled(problem: CalibrationProblem, factor: float) -> CalibrationProblem:
    """Return the problem with positions in another unit; noise that is stated is in metres."""
    noise = factor**2 if "robot" in problem.noise_to_estimate else 1.0
    covariances = noise * problem.position_covariances
    return replace(problem, positions=factor * problem.positions, position_covariances=covariances)


def _with_axes(problem: CalibrationProblem, axes: Array) -> CalibrationProblem:
    """Return the problem in a world of other axes; for left-handed axes, the LED offset is mirrored as well."""
    jacobians = problem.joint_jacobians
    return replace(
        problem,
        positions=problem.positions @ axes.T,
        position_covariances=axes @ problem.position_covariances @ axes.T,
        wrist_rotations=axes @ problem.wrist_rotations @ axes.T,
        joint_jacobians=None if jacobians is None else axes @ jacobians,
    )
