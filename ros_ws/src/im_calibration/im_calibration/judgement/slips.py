"""Common slips in data sets: units, axes, order of quaternions and Euler angles, inverses, pairing, mirror images.

Each slip is undone: the data are changed to what they would be without it. Whether that is so, a fit has to show.
"""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from im_calibration.problem.problem import CalibrationProblem

Array = NDArray[np.float64]

_MIRROR = np.diag([1.0, 1.0, -1.0])
_EULER = (("ZYX", "XYZ"), ("XYZ", "ZYX"), ("ZYX", "zyx"), ("XYZ", "xyz"), ("ZYX", "xyz"))
"""How Euler angles were read, and how they may be meant, capital letters about moving axes; others say the same."""
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
    from scipy.spatial.transform import Rotation  # loads for a third of a second, and few data sets have slips

    given = problem.wrist_rotations
    text = "The wrist's rotations are the wrong way round: with their inverses (wrist -> base)"
    yield Slip(text, _with_wrists(problem, np.swapaxes(given, 1, 2)))
    turns = Rotation.from_matrix(given)
    for order, read, right in (([1, 2, 3, 0], "x, y, z, w", "w, x, y, z"), ([3, 0, 1, 2], "w, x, y, z", "x, y, z, w")):
        text = f"The wrist's quaternions are {right} and were read as {read}: in their own order"
        yield Slip(text, _with_wrists(problem, Rotation.from_quat(turns.as_quat()[:, order]).as_matrix()))
    for read, own in _EULER:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # where two axes are one, any share of the turn is as good
            angles = turns.as_euler(read)
        text = f"The wrist's Euler angles are {_axes_in_words(own)} and were read as {_axes_in_words(read)}: so turned"
        yield Slip(text, _with_wrists(problem, Rotation.from_euler(own, angles).as_matrix()))
    for shift, where in _SHIFTS:
        text = f"The wrist's rotations are those of the pose {where}: shifted by one"
        yield Slip(text, _with_wrists(problem, np.roll(given, -shift, axis=0)))


def _axes_in_words(order: str) -> str:
    return f"about {'moving' if order.isupper() else 'fixed'} {', '.join(order.lower())}"


def _slips_of_axes(problem: CalibrationProblem) -> Iterator[Slip]:
    """Yield positions with other axes than the wrist's rotations."""
    unit, letters = np.eye(3), "xyz"
    mirrored, turned = list[tuple[str, Array]](), list[tuple[str, Array]]()
    for i, letter in enumerate(letters):
        first, second = (other for other in letters if other != letter)
        one = np.outer(unit[i], unit[i])
        mirrored.append((f"with {letter} reversed", unit - 2.0 * one))
        mirrored.append((f"with {first} and {second} exchanged", unit[[i if k == i else 3 - i - k for k in range(3)]]))
        turned.append((f"with {first} and {second} reversed", 2.0 * one - unit))
    for order in ((1, 2, 0), (2, 0, 1)):
        turned.append((f"with x, y, z taken from {', '.join(letters[i] for i in order)}", unit[list(order)]))
    for text, axes, mirror in [(*one, True) for one in mirrored] + [(*one, False) for one in turned]:
        what = "are mirrored" if mirror else "have other axes than the wrist's rotations"
        changed = replace(problem, positions=problem.positions @ axes.T, joint_offset_prior_sd=0.0)
        yield Slip(f"The positions {what}: {text}", changed, mirror)


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
