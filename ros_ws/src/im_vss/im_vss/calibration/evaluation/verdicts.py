"""Whether bad data sets get the right verdict, and good ones none."""

from collections.abc import Iterator
from itertools import cycle, islice

from im_vss.calibration.answer import answer
from im_vss.calibration.evaluation.bad import BAD
from im_vss.calibration.evaluation.kinds import CLEAN, HARD
from im_vss.calibration.synthetic import make_scene


def wrong_verdicts(seed: int, count: int = 60) -> Iterator[tuple[str, int, list[str]]]:
    """Bad sets, kind by kind in turn, that do not get exactly the verdict they should.

    Args:
        seed: Of the first set.
        count: Number of sets.

    Yields:
        Kind, seed, and the verdicts given.
    """
    for i, (name, bad) in enumerate(islice(cycle(BAD.items()), count)):
        flags = answer(bad.make(seed + i))["flags"]
        if flags != [bad.verdict]:
            yield name, seed + i, flags


def false_verdicts(seed: int, count: int = 500) -> Iterator[tuple[str, int, list[str]]]:
    """Good sets, kind by kind in turn, that get a verdict; as :func:`wrong_verdicts`."""
    for i, (name, design) in enumerate(islice(cycle((CLEAN | HARD).items()), count)):
        flags = answer(make_scene(design, seed + i).problem)["flags"]
        if flags:
            yield name, seed + i, flags
