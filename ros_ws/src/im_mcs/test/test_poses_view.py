"""Common views of cameras, and how evenly poses are spread over them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.camera_model import CameraModel
from im_core.errors import DataError
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.poses.common import CommonView
from im_mcs.poses.selection import farthest_first, spread_of
from im_mcs.poses.view import facing, stand

LIGHT_M = 0.02
JOINTS = tuple(f"left_{name}" for name in ("track", "rotation", "tilt", "j1", "j2", "j3", "j4", "j5", "j6"))


def cell_with(cell, **cameras):
    """The cell with its ceiling camera looking elsewhere: name -> (position, target)."""
    like = cell.cameras["ceiling_left"]
    changed = {
        name: like.model_copy(update={"position": position, "target": target})
        for name, (position, target) in cameras.items()
    }
    return cell.model_copy(update={"cameras": {**cell.cameras, **changed}})


def common_view(cell, config, names):
    model = CellModel(cell)
    index = np.array([model.index(joint) for joint in JOINTS], dtype=np.intp)
    limits = JointLimits(model.cell, config.limits, config.slots)
    return CommonView(
        model,
        limits,
        index,
        "left_wrist",
        stand(model, names, "left", JOINTS, LIGHT_M),
        np.array(model.cell.led.offset),
    )


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["up"], "camera 'up' sees no place that the light on left_wrist can reach"),
        (["wall", "left_end", "right_end"], "cameras 'left_end' and 'right_end' see no place in common"),
    ],
)
def test_cameras_without_a_common_view_are_named(cell, config, names, message):
    cell = cell_with(
        cell,
        up=((0.0, 0.0, 3.0), (0.0, 0.1, 9.0)),
        left_end=((-2.0, 0.0, 3.0), (-2.0, 0.1, 0.0)),
        right_end=((1.2, 0.0, 3.0), (1.2, 0.1, 0.0)),
    )
    with pytest.raises(DataError, match=message):
        common_view(cell, config, names)


def test_a_place_is_seen_where_the_camera_model_puts_it_inside_the_image(model):
    (view,) = stand(model, ["wall"], "left", JOINTS, LIGHT_M)
    camera = model.cell.cameras["wall"]
    K = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
    reference = CameraModel(640, 480, K, np.zeros(5), *camera.pose())
    points = np.random.default_rng(3).uniform((-3.0, -4.0, -1.0), (3.0, 2.0, 4.0), (2000, 3))
    near = np.linalg.norm(points - np.array(camera.position), axis=1) < view.nearest
    inside = reference.contains(reference.project(points), margin=20.5) & ~near
    assert 200 < inside.sum() < 1800
    assert (view.sees(points) == inside).all()


def test_a_smaller_light_may_come_nearer_and_a_board_to_wherever_it_is_whole_in_the_image(model):
    (usual,), (small,), (board,) = (stand(model, ["wall"], "left", JOINTS, size) for size in (LIGHT_M, 0.005, 0.0))
    assert usual.nearest == pytest.approx(0.9, abs=0.01), "that of the shipped cell"
    assert small.nearest == pytest.approx(usual.nearest / 4.0)
    ahead = np.array([0.0, 0.0, 0.5]) @ usual.rotation + usual.position
    assert [bool(view.sees(ahead[None])[0]) for view in (usual, small, board)] == [False, True, True]


def test_the_common_view_holds_only_what_all_see(cell, config, model):
    common = common_view(cell, config, ["wall", "table"])
    points = np.random.default_rng(4).uniform(common.lower, common.upper, (500, 3))
    held = points[common.holds(points)]
    assert len(held) > 100
    for view in stand(model, ["wall", "table"], "left", JOINTS, LIGHT_M):
        assert view.sees(held).all()


@pytest.mark.parametrize("names", [["wall"], ["wall", "table"], ["ceiling_left", "ceiling_right", "wall", "table"]])
def test_a_light_faces_the_cameras_as_well_as_any_direction_does(model, names):
    views = stand(model, names, "left", JOINTS, LIGHT_M)
    directions = Rotation.random(20000, random_state=5).apply([0.0, 0.0, 1.0])
    for light in ((0.1, 0.2, 1.1), (-0.7, -0.3, 0.8)):
        towards, best = facing(np.array(light), views)
        assert (towards @ best).min() > (directions @ towards.T).min(axis=1).max() - 1e-3


def test_turning_tells_a_wrist_that_turns_about_one_axis_from_one_that_turns_freely():
    angles = np.linspace(0.0, 6.0, 30)
    lights = np.random.default_rng(6).uniform(size=(30, 3))
    for axis in np.eye(3):
        about_one = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
        assert spread_of(lights, about_one, lights).turning == pytest.approx(0.0, abs=1e-12)
    freely = Rotation.random(3000, random_state=7).as_matrix()
    assert spread_of(lights, freely, lights).turning > 0.99


def test_farthest_points_leave_smaller_holes_and_larger_gaps_than_random_ones():
    rng = np.random.default_rng(8)
    points = rng.uniform((-1.0, -0.5, 0.5), (1.0, 0.5, 1.5), (600, 3))
    wrists = np.tile(np.eye(3), (40, 1, 1))
    chosen = farthest_first(points, 40)
    assert len(set(chosen.tolist())) == 40
    ours = spread_of(points[chosen], wrists, points)
    for _ in range(30):
        chance = spread_of(points[rng.choice(600, 40, replace=False)], wrists, points)
        assert ours.hole_m < 0.85 * chance.hole_m
        assert ours.nearest_m > 1.5 * chance.nearest_m
