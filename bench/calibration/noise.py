"""Data sets whose noise is not as stated: are the factors found, and do the scaled regions hold the truth."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bench.calibration.score import deviations
from bench.calibration.synthetic import Design, make_scene
from im_calibration.estimation.noise import Factor
from im_calibration.pipeline import calibrate
from im_calibration.problem.problem import NOISE_SOURCES

Array = NDArray[np.float64]

DESIGNS = {
    "two cameras": Design(),
    "20 % outliers": Design(outlier_share=0.2, missing_share=0.05),
    "robot noise": Design(sigma_m=2e-3),
    "80 poses, 3 cameras": Design(poses=80, cameras=3),
    "one camera": Design(cameras=1),
}

TRUE_FACTORS = ((1.0, 1.0), (0.3, 0.3), (10.0, 10.0), (0.3, 1.0), (10.0, 1.0), (1.0, 0.3), (1.0, 10.0), (0.3, 10.0))
"""True standard deviation over the stated one, of image and robot."""


@dataclass(frozen=True)
class Found:
    """Shares over trials.

    Attributes:
        image: Trials whose 95 % interval of the image's factor holds the true one.
        robot: The same of the robot's.
        separable: Trials in which the two were told apart.
        coverage: Trials whose scaled 95 % interval holds the truth, by parameter of the cameras and offsets.
        verdicts: Number of trials that got a verdict.
    """

    image: float
    robot: float
    separable: float
    coverage: Array
    verdicts: int


def wrong_noise(design: Design, factors: tuple[float, float], seeds: Iterable[int]) -> Found:
    """Calibrate with the noise estimated from data that state it wrong.

    Args:
        design: What to simulate.
        factors: True standard deviation over the stated one, of image and robot.
        seeds: One a trial.
    """
    image, robot, separable, inside, verdicts = [], [], [], [], 0
    for seed in seeds:
        scene = make_scene(design, seed)
        stated = scene.problem.with_noise(1.0 / factors[0], 1.0 / factors[1])
        calibration = calibrate(replace(stated, noise_to_estimate=NOISE_SOURCES))
        found = calibration.noise.factors
        image.append(_holds(found.image, factors[0]))
        robot.append(_holds(found.robot, factors[1]))
        separable.append(found.separable)
        inside.append(np.abs(deviations(calibration, scene)) < 1.959964 * calibration.standard_deviations)
        verdicts += not calibration.success
    held, apart = (float(np.mean(image)), float(np.mean(robot))), float(np.mean(separable))
    return Found(*held, apart, np.asarray(np.mean(inside, axis=0)), verdicts)


def _holds(factor: Factor, true: float) -> bool:
    return factor.low <= true <= factor.high
