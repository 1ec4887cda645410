"""Slips in data whose noise is not known: each is named with what it gives, and nothing else is given such a name."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.calibration.lenses import LensDesign, make_lens_scene
from bench.calibration.synthetic import Design, bent, make_scene
from im_calibration import calibrate
from im_calibration.judgement.causes import find_slip
from im_cell.workspace import Workspace

BOTH = ("image", "robot")


def with_wrists(problem, rotations):
    return replace(problem, wrist_rotations=rotations)


def with_quaternions(problem, own, read):
    """Rotations whose quaternions were written in one order and read in another."""
    quaternions = Rotation.from_matrix(problem.wrist_rotations).as_quat()
    written = quaternions[:, ["xyzw".index(letter) for letter in own]]
    taken = written[:, [read.index(letter) for letter in "xyzw"]]
    return with_wrists(problem, Rotation.from_quat(taken).as_matrix())


def with_angles(problem, own, read):
    angles = Rotation.from_matrix(problem.wrist_rotations).as_euler(own)
    return with_wrists(problem, Rotation.from_euler(read, angles).as_matrix())


def inverted(problem):
    inverses = np.swapaxes(problem.wrist_rotations, 1, 2)
    return replace(problem, wrist_rotations=inverses, positions=-(inverses @ problem.positions[..., None])[..., 0])


SLIPS = {
    "rotations are the wrong way round": lambda p: with_wrists(p, np.swapaxes(p.wrist_rotations, 1, 2)),
    "quaternions are x, y, z, w and were read as w, x, y, z": lambda p: with_quaternions(p, "xyzw", "wxyz"),
    "quaternions are w, x, y, z and were read as x, y, z, w": lambda p: with_quaternions(p, "wxyz", "xyzw"),
    "Euler angles are about moving z, y, x and were read as about moving x, y, z": lambda p: with_angles(
        p, "ZYX", "XYZ"
    ),
    "Euler angles are about fixed x, y, z and were read as about moving x, y, z": lambda p: with_angles(
        p, "xyz", "XYZ"
    ),
    "Euler angles are about fixed x, y, z and were read as about moving z, y, x": lambda p: with_angles(
        p, "xyz", "ZYX"
    ),
    "rotations are those of the pose before": lambda p: with_wrists(p, np.roll(p.wrist_rotations, 1, axis=0)),
    "rotations are those of the pose after": lambda p: with_wrists(p, np.roll(p.wrist_rotations, -1, axis=0)),
    "spots are those of the pose before": lambda p: replace(p, spots=np.roll(p.spots, 1, axis=1)),
    "poses are inverted": inverted,
    "not in metres: as millimetres": lambda p: replace(
        p, positions=1e3 * p.positions, position_covariances=1e6 * p.position_covariances
    ),
    "mirrored: with y reversed": lambda p: replace(p, positions=p.positions * [1.0, -1.0, 1.0]),
}


def overhead(seed):
    return make_scene(Design(poses=30, led_offset_prior_sd=0.03, outlier_share=0.1), seed).problem


def wide(seed):
    """One wide camera; the LED is 4 to 8 cm from its nominal place."""
    problem = make_lens_scene(LensDesign(60.0, 30, cameras=1, lens="barrel", depth_m=1.0), seed).problem
    offset = np.random.default_rng(seed).normal(size=3)
    offset *= 0.06 / np.linalg.norm(offset)
    positions = problem.positions - problem.wrist_rotations @ offset
    return replace(problem, positions=positions, led_offset_prior_sd=0.06)


@pytest.mark.parametrize(
    ("make", "seed", "words"),
    [(overhead, 61 + i, words) if i % 2 else (wide, 81 + i, words) for i, words in enumerate(SLIPS)],
)
def test_each_slip_is_named_with_what_it_gives(make, seed, words):
    sentence = find_slip(SLIPS[words](replace(make(seed), noise_to_estimate=BOTH)))
    assert words in sentence
    assert "the residual is 0." in sentence


def test_the_nominal_offset_is_turned_with_the_rotations():
    """Positions of which 0.2 m are by rotations that were read wrongly."""
    problem = replace(overhead(65), noise_to_estimate=BOTH)
    wrong = with_quaternions(problem, "xyzw", "wxyz")
    nominal = np.array([0.0, 0.05, 0.2])
    moved = (wrong.wrist_rotations - problem.wrist_rotations) @ nominal
    wrong = replace(wrong, positions=problem.positions + moved, led_offset_nominal=tuple(nominal))
    assert "quaternions are x, y, z, w" in find_slip(wrong)


def test_what_is_no_slip_gets_no_such_name():
    rng = np.random.default_rng(seed := 402)
    design = Design(
        poses=int(rng.integers(20, 60)),
        cameras=1 + seed % 2,
        sigma_px=10.0 ** rng.uniform(-1.5, 0.3),
        sigma_m=10.0 ** rng.uniform(-4.5, -2.3),
        outlier_share=rng.choice([0.0, 0.3]),
        led_offset_prior_sd=rng.choice([0.003, 0.08]),
    )
    scene = make_scene(design, seed)
    sets = {"good": scene.problem}
    sets |= {f"bent by {size} m": bent(scene, "links", size, seed).problem for size in (3e-4, 1e-3)}
    lens = make_lens_scene(LensDesign(80.0, design.poses, cameras=1, lens="fisheye", depth_m=1.0), seed).problem
    sets["another lens"] = replace(lens, led_offset_prior_sd=0.02)
    sets["spots of other poses"] = replace(scene.problem, spots=scene.problem.spots[:, rng.permutation(design.poses)])
    sets["wrists of other poses"] = with_wrists(
        scene.problem, scene.problem.wrist_rotations[rng.permutation(design.poses)]
    )
    named = {what: find_slip(replace(problem, noise_to_estimate=BOTH)) for what, problem in sets.items()}
    assert named == dict.fromkeys(sets, "")


@pytest.mark.parametrize("seed", [70, 74])
def test_positions_of_an_arm_are_in_metres_however_badly_they_fit(seed):
    """Whole readings are off by decimetres: as millimetres they would fit, with the noise of the robot as stated."""
    problem = overhead(seed)
    readings = np.arange(len(problem.positions)) // 3
    errors = np.random.default_rng(seed).normal(scale=0.1, size=(readings[-1] + 1, 3))
    moved = replace(problem, positions=problem.positions + errors[readings], readings=tuple(map(str, readings)))
    assert find_slip(moved) == ""


def test_a_fit_that_ends_early_is_no_slip():
    """Of this set a short fit ends in a camera that is off by 5.5 px, and the honest positions fit to 1 px."""
    rng = np.random.default_rng(13)
    rng.integers(1, 3), rng.choice(3), rng.integers(20, 90)
    noise = {"sigma_px": 10 ** rng.uniform(-1.5, 0.3), "sigma_m": 10 ** rng.uniform(-4.5, -2.3)}
    scene = make_scene(Design(77, outlier_share=rng.choice([0.0, 0.1, 0.3]), led_offset_prior_sd=0.08, **noise), 13)
    kind = [str(rng.choice(["quadratic", "links"])) for _ in range(2)][-1]
    assert find_slip(replace(bent(scene, kind, 1e-3, 13).problem, noise_to_estimate=BOTH)) == ""


def test_a_slip_that_few_rounds_do_not_explain_is_named():
    """The data as they are were fitted from many starts, and each slip from one."""
    space = Workspace((-0.5, -0.5, 0.8), (0.5, 0.5, 1.8))
    design = Design(16, cameras=1, led_offset_prior_sd=0.1, outlier_share=0.1, sigma_px=0.3, workspace=space)
    problem = replace(make_scene(design, 1).problem, noise_to_estimate=BOTH, led_offset_prior_sd=0.15)
    wrong = with_wrists(problem, np.swapaxes(problem.wrist_rotations, 1, 2))
    assert "the wrong way round: with their inverses" in find_slip(wrong)


def test_a_slip_is_the_verdict():
    problem = replace(overhead(66), noise_to_estimate=BOTH)
    calibration = calibrate(with_wrists(problem, np.swapaxes(problem.wrist_rotations, 1, 2)))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]
    assert calibration.message.startswith("MISFIT: The wrist's rotations are the wrong way round: with their inverses")


def test_an_arm_that_repeats_no_place_is_a_misfit():
    """Two cameras tell the noise of the robot from their own."""
    problem = make_scene(Design(poses=60, sigma_m=6e-3, led_offset_prior_sd=0.0), 67).problem
    calibration = calibrate(replace(problem, noise_to_estimate=BOTH))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]
    assert "no arm repeats a place so badly" in calibration.message


def test_width_and_height_are_exchanged_where_all_spots_are_in_both_images():
    design = LensDesign(40.0, 60, cameras=1, image_size=(1920, 1080), depth_m=1.0)
    problem = make_lens_scene(design, 68).problem
    middle = np.all(np.abs(np.nan_to_num(problem.spots[0]) - [540.0, 540.0]) < 535.0, axis=1)
    problem = problem.taking(np.flatnonzero(middle))
    assert calibrate(problem).success
    calibration = calibrate(replace(problem, image_sizes=((1080, 1920),)))
    assert [verdict.kind for verdict in calibration.verdicts] == ["MISFIT"]
    assert "of 1080 x 1920 px: with width and height exchanged it is" in calibration.message
