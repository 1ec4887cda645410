import numpy as np
import pytest

from im_cell.robot import load_cell, shipped_cells
from im_core.errors import DataError, ImError
from im_mcs.collision import CollisionChecker, CollisionMonitor
from im_mcs.limits.configuration import Collision, load_config
from im_mcs.limits.limits import JointLimits
from im_mcs.model import CellModel
from im_mcs.planning import JointPath, Setpoint
from im_mcs.planning.trajectories.profile import ramp, to_rest

PERIOD = 0.0045
LEFT, RIGHT = np.arange(9), np.arange(9, 18)
REACTION = 3


@pytest.fixture(scope="module")
def limits(config, model):
    return JointLimits(model.cell, config.limits)


@pytest.fixture(scope="module")
def checker(config, model):
    return CollisionChecker(model, config.collision.clearance_m)


@pytest.fixture
def monitor(config, model, limits):
    return CollisionMonitor(model, limits.motion, config.collision, [LEFT, RIGHT], PERIOD)


def towards(way, limits):
    """Position, velocity and acceleration at a time, of joints that set out along ``way`` and go on at full speed."""
    moving = way != 0.0
    speed, acceleration, jerk = limits.motion.of(np.flatnonzero(moving)).along(way[moving])
    start = ramp((0.0, 0.0, 0.0), speed, acceleration, jerk)

    def at(t):
        s = start.at(t)
        if t >= start.duration:
            return way * (start.end_setpoint.q[0] + speed * (t - start.duration)), way * speed, np.zeros(len(way))
        return way * s.q[0], way * s.v[0], way * s.a[0]

    return at


def run(monitor, checker, limits, q, way, seconds=4.0, groups=(LEFT, RIGHT)):
    """Set out along ``way`` and brake when told; where it ended, the smallest distance meanwhile, and who was named."""
    at, told, nearest = towards(way, limits), None, np.inf
    for tick in range(int(seconds / PERIOD)):
        step, v, a = at(tick * PERIOD)
        here = q + step
        if tick % 8 == 0:
            nearest = min(nearest, checker.closest(here).distance)
        if told is None and ((here < limits.lower) | (here > limits.upper)).any():
            return here, nearest, None
        proximity = monitor.update(here, v, a)
        if proximity.stop and told is None:
            told = tick, proximity
        if told is not None and tick == told[0] + REACTION:
            brakes = [to_rest(Setpoint(here[g], v[g], a[g]), limits.motion.of(g)) for g in groups]
            longest = max(brake.duration for brake in brakes)
            for t in np.linspace(0.0, longest, 25):
                here = np.concatenate([brake.at(float(t)).q for brake in brakes])
                nearest = min(nearest, checker.closest(here).distance)
            return here, nearest, told[1]
    return here, nearest, None


def ways(count, seed):
    """Random directions of all joints that bring the arms together, or the left one down on the table."""
    random = np.random.default_rng(seed)
    for number in range(count):
        way = random.normal(size=18) * (random.uniform(size=18) < 0.5)
        if number % 2 == 0:
            way[0], way[9] = abs(way[0]) + 0.2, -abs(way[9]) - 0.2
        else:
            way = 0.05 * way
            way[3:6] = random.uniform([0.7, -1.0, 0.2], [1.0, -0.7, 0.8])
        yield way / np.abs(way).max()


def test_braking_when_told_never_ends_in_contact(monitor, checker, limits, cell):
    stopped = []
    for way in ways(24, seed=7):
        _, nearest, told = run(monitor, checker, limits, cell.home, way)
        assert nearest > 0.0
        if told is not None:
            stopped.append({told.first, told.second})
    assert len(stopped) > 10
    assert any("table" in pair for pair in stopped)
    assert any({name.split("_")[0] for name in pair} == {"left", "right"} for pair in stopped)


@pytest.mark.parametrize("name", [name for name in shipped_cells() if name != "puma_pair"])
def test_an_arm_of_another_cell_that_folds_brakes_before_it_meets_itself_or_the_floor(name):
    cell = load_cell(name)
    config, model = load_config(cell=cell), CellModel(cell)
    limits = JointLimits(cell, config.limits, config.slots)
    groups = [np.array([model.index(joint) for joint in cell.joints_of(group)]) for group in cell.groups]
    monitor = CollisionMonitor(model, limits.motion, config.collision, groups, PERIOD)
    checker, random, stopped = CollisionChecker(model, config.collision.clearance_m), np.random.default_rng(5), 0
    for _ in range(16):
        way = random.normal(size=model.n)
        _, nearest, told = run(monitor, checker, limits, cell.home, way / np.abs(way).max(), groups=groups)
        assert nearest > 0.0, told
        stopped += told is not None
    assert stopped >= 3


def test_motions_along_free_paths_are_not_stopped(monitor, checker, limits, cell):
    random, q, slowest, moves = np.random.default_rng(1), cell.home.copy(), 1.0, 0
    while moves < 8:
        reach = np.array([0.6, 0.5, 0.2, 1.0, 0.6, 0.6, 1.0, 1.0, 1.0] * 2)
        target = np.clip(cell.home + random.uniform(-1.0, 1.0, size=18) * reach, limits.lower, limits.upper)
        try:
            checker.check_path(q, np.arange(18), np.array([q, target]))
        except ImError:
            continue
        path = JointPath(q, target[None], limits.motion)
        for t in np.arange(0.0, path.duration, PERIOD):
            s = path.at(float(t))
            proximity = monitor.update(s.q, s.v, s.a)
            assert not proximity.stop, proximity
            slowest = min(slowest, proximity.speed_ceiling)
        q, moves = target, moves + 1
    assert slowest == 1.0  # all of them stay far off


def test_the_way_back_is_free_and_the_way_on_is_not(monitor, checker, limits, cell):
    """However often one sets out again towards the other body."""
    tried = 0
    for way in ways(20, seed=7):
        q, nearest, told = run(monitor, checker, limits, cell.home, way)
        if told is None:
            continue
        tried += 1
        for _ in range(4):
            q, nearest, _ = run(monitor, checker, limits, q, way, seconds=0.5)
            assert nearest > 0.0
        back = towards(-way, limits)
        for tick in range(60):
            step, v, a = back(tick * PERIOD)
            assert not monitor.update(q + step, v, a).stop
        if tried == 4:
            return
    raise AssertionError("too few motions were stopped")


def test_distances_are_exact_near_and_never_too_large(config, model, monitor, checker, limits, cell):
    near = 0
    for way in ways(10, seed=3):
        at = towards(way, limits)
        for tick in range(400):
            q = cell.home + at(tick * PERIOD)[0]
            proximity = monitor.update(q, np.zeros(18), np.zeros(18))  # at rest: where it is, is where it stops
            if tick % 4 or tick < 200:
                continue
            exact = checker.closest(q).distance
            assert proximity.distance <= exact + 1e-6
            if exact < config.collision.slow_down_m:
                near += 1
                assert proximity.distance == pytest.approx(exact, abs=1e-6)
            assert not proximity.stop  # nothing moves
            assert proximity.speed_ceiling == 1.0
    assert near > 10


def test_the_ceiling_falls_gradually_towards_a_body(config, model, limits, checker, cell):
    """Slow enough that braking takes almost no way: the ceiling is that of the place."""
    settings = config.collision
    monitor = CollisionMonitor(model, limits.motion, settings, [LEFT, RIGHT], PERIOD)
    way = np.zeros(18)
    way[0] = 1.0
    q, v = cell.home.copy(), 0.12 * way
    q[9] = 0.3
    ceilings, stopped = [1.0], False
    while not stopped:
        q = q + v * PERIOD
        proximity = monitor.update(q, v, np.zeros(18))
        ceilings.append(proximity.speed_ceiling)
        stopped = proximity.stop
        assert checker.closest(q).distance > 0.0
    falls = -np.diff(ceilings)
    assert (falls >= 0.0).all()
    assert falls.max() < 0.1
    assert ceilings[-1] == pytest.approx(settings.slowest, abs=0.02)
    assert {proximity.first.split("_")[0], proximity.second.split("_")[0]} == {"left", "right"}


def test_two_runs_say_the_same(config, model, limits, cell):
    def said():
        monitor = CollisionMonitor(model, limits.motion, config.collision, [LEFT, RIGHT], PERIOD)
        at = towards(next(ways(1, seed=9)), limits)
        return [monitor.update(cell.home + at(k * PERIOD)[0], *at(k * PERIOD)[1:]) for k in range(150)]

    assert said() == said()


def test_motion_that_is_not_finite_is_refused(monitor, cell):
    v = np.zeros(18)
    v[3] = np.nan
    with pytest.raises(DataError, match="not finite"):
        monitor.update(cell.home, v, np.zeros(18))
    assert monitor.update(cell.home, np.zeros(18), np.zeros(18)).distance > 0.0


def test_distances_in_the_wrong_order_are_refused():
    with pytest.raises(ValueError, match="do not increase: paths that are allowed would be stopped"):
        Collision(slow_down_m=0.04, clearance_m=0.02, stop_m=0.03, slowest=0.1, reaction_ticks=4)
