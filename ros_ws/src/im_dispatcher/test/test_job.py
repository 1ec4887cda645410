"""The loop of calibrate_camera without ROS."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import DataError, NotFoundError
from im_dispatcher.job import FEWEST_POSES, CalibrationJob, check
from im_dispatcher.poses_file import WristPose

CAMERAS = ["ceiling_left", "ceiling_right"]


def make_poses(count: int) -> list[WristPose]:
    return [
        WristPose(name=f"p{i}", position_m=(0.1 * i, 0.0, 1.0), orientation_xyzw=(0.0, 0.6, 0.0, 0.8))
        for i in range(count)
    ]


def make_job(count: int = 20) -> CalibrationJob:
    return CalibrationJob(cameras=CAMERAS, poses=make_poses(count), directory="/tmp/results")


def returned(job: CalibrationJob) -> CalibrationJob:
    """The job after its dispatcher died and came back."""
    return CalibrationJob.from_dict(json.loads(json.dumps(job.to_dict())))


@given(st.lists(st.booleans(), min_size=FEWEST_POSES, max_size=40), st.lists(st.integers(0, 39)))
def test_every_pose_is_either_observed_or_skipped_whenever_the_dispatcher_dies(
    outcomes: list[bool], deaths: list[int]
) -> None:
    job = make_job(len(outcomes))
    for number, seen in enumerate(outcomes):
        assert job.more_poses()
        job.take()
        if number in deaths:
            job = returned(job)
        if seen:
            job.keep()
        else:
            job.skip("hidden")
    assert not job.more_poses()
    assert job.progress == 1.0
    assert sorted([*job.kept, *(skipped.pose for skipped in job.skipped)]) == sorted(pose.name for pose in job.poses)
    with pytest.raises(DataError, match="all poses have been visited"):
        job.take()


def test_a_job_comes_back_as_it_was() -> None:
    job = make_job()
    job.take()
    job.keep()
    job.take()
    job.skip("out of reach")
    assert returned(job) == job


def test_a_pose_is_dispensable_only_while_enough_remain() -> None:
    job = make_job(FEWEST_POSES + 1)
    job.take()
    assert job.dispensable("spot_not_found")
    assert not job.dispensable("state")
    job.skip("hidden")
    job.take()
    assert not job.dispensable("spot_not_found")


def test_wrong_cameras_and_too_few_poses_are_named() -> None:
    known = (*CAMERAS, "wall")
    with pytest.raises(NotFoundError, match="no camera 'ceiling_lefd'; did you mean 'ceiling_left'"):
        check(["ceiling_lefd"], make_poses(20), known)
    with pytest.raises(DataError, match="'wall' is named twice"):
        check(["wall", "wall"], make_poses(20), known)
    with pytest.raises(DataError, match="at least one camera"):
        check([], make_poses(20), known)
    with pytest.raises(DataError, match=f"5 poses are too few .* at least {FEWEST_POSES}"):
        check(CAMERAS, make_poses(5), known)
