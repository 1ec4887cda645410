"""Jobs with a target: closed form and one adjustment, whose errors are those that it states; slips are named."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bench.calibration.target_views import JOBS, bent, errors_over_expected, make_views
from im_calibration.errors import DegenerateDataError, InconsistentDataError
from im_calibration.estimation.residuals import image_residuals, linearise
from im_calibration.estimation.search import robust_start
from im_calibration.estimation.unknowns import ParameterLayout
from im_calibration.pipeline import calibrate
from im_calibration.problem.dataset import SCHEMA, problems
from im_calibration.problem.target_problem import problem_of_views, table_of
from im_calibration.reporting.report import report_of
from im_calibration.selection import calibrate_possible
from im_calibration.targets.closed_form import frames_of
from im_calibration.targets.target import target_of
from im_cell.calibration_summary import brief_summary, summary
from im_core.errors import DataError

SMALL = target_of("chessboard:5x4:45mm")


@pytest.mark.parametrize("job", JOBS)
def test_errors_are_as_large_as_stated(job):
    ratios = []
    for seed in range(6 if job == "one camera" else 3):
        true = make_views(job, seed, target=SMALL)
        found = calibrate(problem_of_views(true.views, ()))
        assert found.success, found.message
        ratios.append(errors_over_expected(found, true))
    ratios = np.array(ratios)
    assert 0.75 < np.sqrt(np.mean(ratios**2)) < 1.3
    assert np.mean(np.abs(ratios) < 1.96) > 0.88


def test_unknown_noise_is_found():
    true = make_views("eye-to-hand", 3, target=SMALL)
    views = replace(
        true.views, deviations=3.0 * true.views.deviations, robot=replace(true.views.robot, sd_m=2e-3, sd_rad=4e-3)
    )
    found = calibrate(problem_of_views(views, ("image", "robot")))
    assert found.success, found.message
    assert found.noise.factors.image.low < 1.0 / 3.0 < found.noise.factors.image.high
    assert found.noise.factors.robot.low < 0.25 < found.noise.factors.robot.high


def test_what_no_robot_is_like_is_told():
    views = make_views("eye-in-hand", 3, target=SMALL, sd_m=0.01, sd_rad=0.02).views
    found = calibrate(problem_of_views(views, ("image", "robot")))
    assert "no arm repeats a place so badly" in found.message


def test_a_robot_whose_turns_are_rough_repeats_its_place_well():
    views = make_views("eye-in-hand", 3, target=SMALL, sd_m=1e-3, sd_rad=8e-3).views
    found = calibrate(problem_of_views(views, ("image", "robot")))
    assert found.success, found.message
    factor = found.noise.factors.robot
    assert factor.low < 1e-3 / found.noise.robot_m < factor.high


@pytest.mark.parametrize("job", ["two cameras", "eye-in-hand"])
def test_jacobian_of_placements_by_finite_differences(job):
    problem = problem_of_views(make_views(job, 1, target=SMALL, count=5).views, ())
    layout = ParameterLayout.of(problem)
    at = robust_start(problem, layout)
    still = np.zeros_like(problem.positions)
    at = replace(at, displacements=still)
    line = linearise(at, problem, layout, problem.detected)
    for k in range(layout.placed_slice.start, layout.placed_slice.stop):
        step = np.zeros(layout.size)
        step[k] = 1e-6
        ahead = image_residuals(at.moved(step, layout, still), problem, problem.detected)
        behind = image_residuals(at.moved(-step, layout, still), problem, problem.detected)
        np.testing.assert_allclose(line.jacobians[:, :, k], (behind - ahead) / 2e-6, rtol=1e-4, atol=1e-3)


def test_a_target_without_a_robot_has_no_light_in_its_summary():
    problem = problem_of_views(make_views("one camera", 5, target=SMALL).views, ())
    text = summary(report_of(calibrate(problem), problem))
    assert "LED" not in text
    assert "light" not in brief_summary(report_of(calibrate(problem), problem))
    assert "points used         299 of 300" in text


def test_a_point_found_wrongly_is_left_out():
    true = make_views("one camera", 5, target=SMALL)
    spots = true.views.spots.copy()
    spots[0, 4, 7] += 5.0
    found = calibrate(problem_of_views(replace(true.views, spots=spots), ()))
    assert found.success, found.message
    (rejection,) = (each for each in found.rejections if each.pose == "view_4")
    assert "1 of 20 points" in rejection.reason


def test_a_stale_pose_of_the_robot_is_left_out():
    true = make_views("eye-in-hand", 6, target=SMALL)
    poses = true.views.robot.poses.copy()
    poses[3, :3, 3] += 0.05
    found = calibrate(problem_of_views(replace(true.views, robot=replace(true.views.robot, poses=poses)), ()))
    assert found.success, found.message
    (rejection,) = (each for each in found.rejections if each.pose == "view_3")
    assert "stale pose of the robot?" in rejection.reason


def test_held_intrinsics_stay_and_given_ones_keep_their_certainty():
    true = make_views("eye-to-hand", 2, target=SMALL)
    camera = true.cameras[0]
    values = np.concatenate((camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], camera.D[:4]))
    held = (values, np.diag(1e-7 * np.maximum(np.abs(values), 1e-3)) ** 2)
    found = calibrate(problem_of_views(replace(true.views, given={"camera_0": held}), ()))
    assert found.success, found.message
    np.testing.assert_allclose(found.cameras[0].model.K, camera.K, atol=1e-3)
    alone = calibrate(problem_of_views(true.views, ()))
    assert np.all(found.standard_deviations[8:14] < alone.standard_deviations[8:14])
    off = np.array([0.5, 0.5, 0.3, 0.3, 0.0, 0.0, 0.0, 0.0])
    given = (values + off, np.diag([0.5, 0.5, 0.3, 0.3, 1e-2, 1e-2, 1e-4, 1e-4]) ** 2)
    prior = calibrate(problem_of_views(replace(true.views, given={"camera_0": given}), ()))
    assert np.all(prior.standard_deviations[:8] < np.sqrt(np.diag(given[1])) * 1.001)
    assert np.all(prior.standard_deviations[:8] < alone.standard_deviations[:8])
    assert np.sqrt(np.mean(errors_over_expected(prior, true) ** 2)) < 2.0


def test_the_block_of_a_data_set_holds_everything():
    for job in ("two cameras", "eye-in-hand"):
        views = make_views(job, 4, target=SMALL, count=6).views
        content = {
            "schema": SCHEMA,
            "camera_names": list(views.camera_names),
            "image_size": [640, 480],
            "target": json.loads(json.dumps(table_of(views))),
        }
        (read,) = problems(content)
        made = problem_of_views(views, ())
        np.testing.assert_array_equal(read.spots, made.spots)
        np.testing.assert_array_equal(read.positions, made.positions)
        assert read.readings == made.readings


def test_covariances_of_readings_are_the_noise_of_place_and_turn_where_these_are_alike():
    views = make_views("eye-to-hand", 4, target=SMALL, count=8).views
    stated = np.diag([views.robot.sd_m**2] * 3 + [views.robot.sd_rad**2] * 3)
    by_reading = replace(views.robot, sd_m=0.0, sd_rad=0.0, covariances=np.tile(stated, (8, 1, 1)))
    alike, made = (problem_of_views(each, ()) for each in (views, replace(views, robot=by_reading)))
    np.testing.assert_allclose(made.position_covariances, alike.position_covariances, atol=1e-15)
    content = {"schema": SCHEMA, "image_size": [640, 480], "noise_to_estimate": [], "target": None}
    content["target"] = json.loads(json.dumps(table_of(replace(views, robot=by_reading))))
    content["camera_names"] = list(views.camera_names)
    (read,) = problems(content)
    np.testing.assert_array_equal(read.position_covariances, made.position_covariances)
    assert read.noise_to_estimate == ()
    content["target"]["robot"]["camera_moves"] = True
    with pytest.raises(DataError, match=r"target\.robot\.cov is for a target on the robot; here the cameras are on it"):
        problems(content)


def stretched(robot, errors):
    """A robot off by a stretch along each axis, and by a turn that grows with x; what it reads, with derivatives."""
    x, y, z = robot.poses[:, :3, 3].T
    arm = np.zeros((len(x), 6, 4))
    for k, place in enumerate((x, y, z)):
        arm[:, k, k] = 2e-3 * place
    arm[:, 5, 3] = 2e-3 * x
    off, poses = arm @ errors, robot.poses.copy()
    poses[:, :3, 3] -= off[:, :3]
    poses[:, :3, :3] = Rotation.from_rotvec(-off[:, 3:]).as_matrix() @ poses[:, :3, :3]
    return replace(robot, poses=poses, arm=arm)


def test_the_error_of_an_arm_whose_kinematics_are_given_is_in_what_is_stated():
    """Of intrinsics: what an error shifts and turns alike is in the frame of the cameras."""
    ratios = []
    for seed in range(4):
        true = make_views("eye-to-hand", seed, target=SMALL, count=20, sd_m=2e-5, sd_rad=4e-5)
        robot = stretched(true.views.robot, np.random.default_rng(seed).normal(size=4))
        found = calibrate(problem_of_views(replace(true.views, robot=robot), ("image",)))
        assert found.arm_error_m > 0.0
        ratios.append(errors_over_expected(found, true)[:8])
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 1.6


@pytest.mark.parametrize("noise", [(), ("image", "robot")])
@pytest.mark.parametrize("job", ["eye-to-hand", "eye-in-hand"])
def test_the_error_of_an_arm_whose_kinematics_are_not_given_is_in_what_is_stated(job, noise):
    """Of all: places of camera and target, and intrinsics."""
    ratios = []
    for seed in range(3):
        true = bent(make_views(job, seed, target=SMALL, count=20, sd_m=2e-5, sd_rad=3e-5), 5e-4, seed)
        found = calibrate(problem_of_views(true.views, noise))
        assert found.success, found.message
        assert "The error of the arm is taken to be about" in found.message
        assert 1e-4 < found.arm_error_m < 2e-3
        ratios.append(errors_over_expected(found, true))
    assert np.sqrt(np.mean(np.square(ratios))) < 1.4
    assert np.mean(np.abs(ratios) < 1.96) > 0.85


@pytest.mark.parametrize("noise", [(), ("image", "robot")])
def test_the_bare_noise_of_a_robot_bends_no_arm(noise):
    views = [make_views("eye-in-hand", seed, target=SMALL, count=20).views for seed in range(2)]
    assert [calibrate(problem_of_views(each, noise)).arm_error_m for each in views] == [0.0] * 2


@pytest.mark.parametrize("job", ["eye-to-hand", "eye-in-hand"])
def test_errors_of_a_reading_move_the_points_as_another_reading_does(job):
    views = make_views(job, 1, target=SMALL, count=5).views
    placements, robot = problem_of_views(views, ()).placements, views.robot
    of = np.repeat(np.arange(5), len(placements.points) // 5)
    sizes = np.repeat([robot.sd_m, robot.sd_rad], 3)
    for k, step in enumerate(1e-6 * np.eye(6)):
        moved = robot.poses.copy()
        moved[:, :3, 3] += step[:3]
        moved[:, :3, :3] = Rotation.from_rotvec(step[3:]).as_matrix() @ moved[:, :3, :3]
        before, after = (
            (frames[of, :3, :3] @ placements.points[..., None])[..., 0] + frames[of, :3, 3]
            for frames in (frames_of(each) for each in (robot, replace(robot, poses=moved)))
        )
        np.testing.assert_allclose(placements.roots[:, :, k] / sizes[k], (after - before) / 1e-6, atol=1e-5)


def test_held_intrinsics_of_another_lens_are_a_misfit_and_no_crash():
    """A held lens that is not the camera's: no other model is tried in the place of what is given."""
    true = make_views("eye-to-hand", 2, target=SMALL)
    camera = true.cameras[0]
    values = np.concatenate((camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], 0.5 * camera.D[:4]))
    held = (values, np.diag(1e-7 * np.maximum(np.abs(values), 1e-3)) ** 2)
    found = calibrate(problem_of_views(replace(true.views, given={"camera_0": held}), ()))
    assert "MISFIT" in found.message


def test_a_camera_that_saw_too_little_leaves_the_others_of_a_robot():
    views = make_views("eye-to-hand", 4, target=SMALL).views
    blind = np.full_like(views.spots, np.nan)
    blind[:, 0, :5] = views.spots[:, 0, :5]
    both = replace(
        views, camera_names=("camera_0", "camera_1"), image_sizes=views.image_sizes * 2, lens_models=("plumb_bob",) * 2,
        spots=np.concatenate((views.spots, blind)), deviations=np.tile(views.deviations, (2, 1, 1)),
    )  # fmt: skip
    found = calibrate_possible(problem_of_views(both, ()))
    assert [camera.name for camera in found.cameras] == ["camera_0"]
    assert "camera_1" in found.message
    with pytest.raises(DegenerateDataError, match="at least 3 are needed"):
        problem_of_views(replace(views, spots=blind), ())


def slipped(robot, how):
    """The poses of a robot with a slip."""
    poses = robot.poses.copy()
    if how == "inverse":
        return np.linalg.inv(poses)
    if how == "millimetres":
        poses[:, :3, 3] *= 1e3
    elif how == "order":
        poses[:, :3, :3] = Rotation.from_quat(
            Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [1, 2, 3, 0]]
        ).as_matrix()
    elif how == "shifted":
        poses = np.roll(poses, 1, axis=0)
    elif how == "centimetres":
        poses[:, :3, 3] *= 1e2
    elif how == "size":
        poses[:, :3, 3] *= 1.2
    elif how == "angles":
        angles = Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz")
        poses[:, :3, :3] = Rotation.from_euler("XYZ", angles).as_matrix()
    elif how == "reversed":
        poses[:, 1, 3] *= -1.0
    elif how == "exchanged":
        poses[:, :3, 3] = poses[:, [1, 0, 2], 3]
    elif how == "left-handed":
        mirror = np.diag([1.0, -1.0, 1.0, 1.0])
        poses = mirror @ poses @ mirror
    return poses


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ("inverse", "With their inverses"),
        ("millimetres", "With places in millimetres"),
        ("order", "With quaternions read as"),
        ("shifted", "With the poses taken one image earlier"),
        ("centimetres", "With places in centimetres, they are off by"),
        ("size", "With the target 1.2 times as large, or places 0.83. times as far apart, they are off by"),
        ("angles", "With Euler angles read as about fixed x, y, z, they are off by"),
        ("reversed", "With y reversed in the places, they are off by"),
        ("exchanged", "With x and y exchanged in the places, they are off by"),
        ("left-handed", "With left-handed axes of the robot, or all images mirrored, they are off by"),
    ],
)
@pytest.mark.parametrize("job", ["eye-to-hand", "eye-in-hand"])
def test_slips_of_the_robot_are_named(job, how, told):
    views = make_views(job, 7, target=SMALL).views
    wrong = replace(views, robot=replace(views.robot, poses=slipped(views.robot, how)))
    with pytest.raises(InconsistentDataError, match=told):
        problem_of_views(wrong, ())


def test_what_cannot_be_known_is_told():
    views = make_views("one camera", 8, target=SMALL, count=2).views
    with pytest.raises(DegenerateDataError, match="saw the target in 2 images, at least 3 are needed"):
        problem_of_views(views, ())
    pair = make_views("two cameras", 8, target=SMALL, count=8).views
    spots = pair.spots.copy()
    spots[0, :4] = spots[1, 4:] = np.nan
    with pytest.raises(DegenerateDataError, match="No image of camera_1 has the target where another camera has it"):
        problem_of_views(replace(pair, spots=spots), ())
    arm = make_views("eye-in-hand", 8, target=SMALL, count=6).views
    poses = arm.robot.poses.copy()
    poses[:, :3, :3] = [Rotation.from_rotvec([0.0, 0.0, 0.2 * k]).as_matrix() for k in range(6)]
    with pytest.raises(DegenerateDataError, match="The robot turns about one axis only"):
        problem_of_views(replace(arm, robot=replace(arm.robot, poses=poses)), ())


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"points_m": [[0, 0]]}, "target.points_m.* has 2 elements, 3 are needed"),
        ({"u_px": [[[[1, 2]]]]}, "target.u_px.* has 1 elements"),
        (
            {"robot": {"poses": [np.eye(4).tolist()] * 5, "camera_moves": True}},
            "target.robot.poses has 5 elements, 6 are",
        ),
        ({"squares": 3}, "target has the field 'squares', which the format does not"),
    ],
)
def test_a_wrong_block_is_told_with_its_place(change, told):
    views = make_views("one camera", 4, target=SMALL, count=6).views
    content = {"schema": SCHEMA, "image_size": [640, 480], "target": {**table_of(views), **change}}
    with pytest.raises(DataError, match=told):
        problems(content)
