"""CPU time of searches for free paths among the shipped free bodies, and an independent check of the paths.

With the tool upright a goal is the end of a walk that keeps the tool so. Between two that are drawn there may be no
path: limits of joints may part the upright positions.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bench.figures import Line
from im_cell.robot import load_cell
from im_cell.robot.objects import ObjectsFile
from im_coordinators.free_path import FreeSpace, find_path
from im_coordinators.upright import Upright
from im_core import clock
from im_core.config import load_model, package_file
from im_core.errors import ImError
from im_mcs.collision import Bodies, CollisionScene, Thing
from im_mcs.limits.configuration import McsConfig
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel

Array = NDArray[np.float64]

_QUERIES, _QUERIES_OF_BOTH = 200, 40
_WITHIN_S, _MEDIAN_S, _SHARE = 2.0, 0.3, 0.95
_STEP = 1e-3
#: Every so many paths, one is checked in steps: that takes far longer than to find it.
_CHECKED = 5
#: Least distance of the carts of two arms on their track [m]: they cannot pass each other.
_APART_M = 0.5
#: Limit of the tilt of an upright tool [rad]; steps of a walk to a goal and their length [rad or m].
_TILT, _WALK, _STRIDE = 0.1, 40, 0.9


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Queries whose straight line is blocked: of each arm in turn, of both, and of each with the tool upright."""
    cell = load_cell()
    model, limits = CellModel(cell), JointLimits(cell, config.limits, config.slots)
    objects = load_model(package_file("im_cell", "cells/puma_pair/objects.yaml"), ObjectsFile).objects
    around = CollisionScene(
        tuple(Thing.checked(body.name, body.kind, body.size, "world", body.start.tolist()) for body in objects)
    )
    bodies = Bodies(model, around)
    clearance, half = config.collision.clearance_m, model.n // 2
    random = np.random.default_rng(seed)
    arms = [np.arange(half), np.arange(half, model.n)]
    found: list[Line] = []
    wrists = [group.tip for group in cell.groups.values()]
    for name, queries, groups, tilt in (
        (f"{half} joints", _QUERIES, arms, None),
        (f"{model.n} joints", _QUERIES_OF_BOTH, [np.arange(model.n)], None),
        (f"{half} joints, upright within {_TILT:g} rad", _QUERIES, arms, _TILT),
    ):
        seconds, refused, steps, checked = [], 0, 0, 0
        for number in range(queries):
            index = groups[number % len(groups)]
            q, lower, upper = cell.home.copy(), limits.lower[index], limits.upper[index]
            space, upright, goal = FreeSpace(model, lower, upper, clearance, q, index, around), None, None
            if tilt is None:
                q[index], goal = _blocked(space, random)
            while goal is None:
                q[index] = random.uniform(lower, upper)
                upright = Upright(model, wrists[number % len(groups)], _TILT, q)
                space = FreeSpace(model, lower, upper, clearance, q, index, around, upright)
                q[index], goal = _walked(space, q[index], random)
            began = clock.cpu()
            space = FreeSpace(model, lower, upper, clearance, q, index, around, upright)
            try:
                path = find_path(space, q[index], [goal], number)
            except ImError:
                seconds.append(np.inf)
                continue
            seconds.append(clock.cpu() - began)
            if number % _CHECKED == 0:
                closest, most, looked = _extremes(bodies, upright, q, index, np.vstack([q[index], path.points]))
                refused, steps = refused + (closest < clearance or most > _TILT), steps + looked
                checked += 1
        share = float(np.mean(np.array(seconds) <= _WITHIN_S))
        found += [
            Line(f"{name}: CPU time of a path, median", float(np.median(seconds)), "s", bar=_MEDIAN_S),
            Line(f"  95 % of {queries}", float(np.quantile(seconds, 0.95)), "s"),
            Line(f"  share of {queries} within {_WITHIN_S:g} s", share, "", bar=_SHARE, at_least=True),
            Line(f"  of {checked}, refused in {steps} steps of {_STEP:g} rad or m", float(refused), "", bar=0.0),
        ]
    return found


def _blocked(space: FreeSpace, random: np.random.Generator) -> tuple[Array, Array]:
    """Draw two free positions with something between them."""
    while True:
        a, b = (random.uniform(space.lower, space.upper) for _ in range(2))
        half = len(a) // 2
        passing = len(a) > 2 * 6 and any(q[0] > q[half] - _APART_M for q in (a, b))
        if not passing and space.free(a) and space.free(b) and not space.line_free(a, b):
            return a, b


def _walked(space: FreeSpace, start: Array, random: np.random.Generator) -> tuple[Array, Array | None]:
    """Draw a free position with the tool upright, and another one that no straight line leads to, if there is one."""
    first = space.projected(start)
    if first is None or not space.free(first):
        return start, None
    goal = first
    for _ in range(_WALK):
        way = random.normal(size=len(first))
        step = space.projected(goal + way * (_STRIDE / np.linalg.norm(way)))
        goal = goal if step is None or not space.line_free(goal, step) else step
    return first, None if space.line_free(first, goal) else goal


def _extremes(
    bodies: Bodies, upright: Upright | None, q_all: Array, index: NDArray[np.intp], points: Array
) -> tuple[float, float, int]:
    """Return the smallest distance on a path [m] and the largest tilt [rad] at every step, and the number of steps."""
    whole, least, most, steps = q_all.copy(), np.inf, 0.0, 0
    for a, b in pairwise(points):
        count = int(np.ceil(np.abs(b - a).max() / _STEP))
        steps += count
        for k in range(count + 1):
            whole[index] = a + (b - a) * (k / count)
            bodies.place(whole)
            least = min(least, bodies.closest().distance)
            most = most if upright is None else max(most, upright.tilt(whole))
    return least, most, steps
