"""The calibration of few and of many poses."""

from collections.abc import Sequence
from functools import partial

from bench.calibration.synthetic import Design, make_scene
from bench.figures import Line
from bench.sizes.growth import growth
from bench.yardstick import cpu_of
from im_calibration import calibrate


def lines(sizes: Sequence[int], rounds: int) -> list[Line]:
    """CPU time of one calibration of two cameras, the least of some rounds."""
    problems = {poses: make_scene(Design(poses=poses), seed=1).problem for poses in sizes}
    calibrate(problems[min(sizes)])  # what is loaded with the first is not counted
    used = {
        poses: min(cpu_of(partial(calibrate, problem)) for _ in range(rounds)) for poses, problem in problems.items()
    }
    return growth("calibration, CPU", used, "s", "poses")
