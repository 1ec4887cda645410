"""The loop of calibrate_camera without ROS."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError, NotFoundError
from im_dispatcher.job import FEWEST_POSES, CalibrationJob
from im_dispatcher.poses_file import WristPose

CAMERAS = ("ceiling_left", "ceiling_right")


def make_job(count: int = 20, cameras: tuple[str, ...] = CAMERAS) -> CalibrationJob[str]:
    poses = [
        WristPose(name=f"p{i}", position_m=(0.0, 0.0, 1.0), orientation_xyzw=(0.0, 0.0, 0.0, 1.0)) for i in range(count)
    ]
    return CalibrationJob(cameras=cameras, poses=poses, known_cameras=(*CAMERAS, "wall"))


@given(st.lists(st.booleans(), min_size=FEWEST_POSES, max_size=40))
def test_every_pose_is_either_observed_or_skipped(outcomes: list[bool]) -> None:
    job = make_job(len(outcomes))
    for seen in outcomes:
        assert job.more_poses()
        pose = job.take()
        if seen:
            job.keep(pose.name)
        else:
            job.skip("hidden")
    assert not job.more_poses()
    assert job.progress == 1.0
    assert sorted([*job.observations, *(skipped.pose for skipped in job.skipped)]) == sorted(
        pose.name for pose in job.poses
    )
    with pytest.raises(DataError, match="all poses have been visited"):
        job.take()


def test_a_pose_is_dispensable_only_while_enough_remain() -> None:
    job = make_job(FEWEST_POSES + 1)
    job.take()
    assert job.dispensable("spot_not_found")
    assert not job.dispensable("state")
    job.skip("hidden")
    job.take()
    assert not job.dispensable("spot_not_found")


def test_wrong_cameras_and_too_few_poses_are_named() -> None:
    with pytest.raises(NotFoundError, match="no camera 'ceiling_lefd'; did you mean 'ceiling_left'"):
        make_job(cameras=("ceiling_lefd",))
    with pytest.raises(DataError, match="'wall' is named twice"):
        make_job(cameras=("wall", "wall"))
    with pytest.raises(DataError, match="at least one camera"):
        make_job(cameras=())
    with pytest.raises(DataError, match=f"5 poses are too few .* at least {FEWEST_POSES}"):
        make_job(5)
