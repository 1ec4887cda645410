"""Nets of few and of many places: a firing, and the proof that nothing gets stuck."""

from collections.abc import Sequence
from functools import partial

from bench.figures import Line
from bench.nets.families import ring
from bench.nets.player import Work
from bench.nets.workers import number, own
from bench.sizes.growth import growth
from bench.yardstick import cpu_of
from im_pnt_analysis.verify.verdict import verify


def lines(sizes: Sequence[int], firings: int) -> list[Line]:
    """CPU time of an observed firing, and of all answers of ``verify``, of rings.

    Raises:
        LinkError: A process fails.
    """
    fired = {}
    for places in sizes:
        with own("bench.nets.player") as worker:
            worker.ask("load", family="ring", places=places, work=Work.NONE, folder="")
            worker.ask("fire", firings=1000)
            answer = worker.ask("fire", firings=firings)
        fired[places] = 1e6 * number(answer, "cpu_s") / number(answer, "firings")
    verify([ring(min(sizes))])  # what is loaded with the first is not counted
    proved = {places: cpu_of(partial(verify, [ring(places)])) for places in sizes}
    return [
        *growth("firing of a ring, CPU", fired, "us", "places", linear=False),
        *growth("verify a ring, CPU", proved, "s", "places"),
    ]
