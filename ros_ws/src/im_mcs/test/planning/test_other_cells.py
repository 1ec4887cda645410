"""Motion of the first arm of other shipped cells, at random: jogs, trajectories that are too quick, and lines."""

import numpy as np
import pinocchio as pin
import pytest

from im_cell.robot import load_cell, shipped_cells
from im_mcs.limits.configuration import load_config
from im_mcs.model import CellModel

OTHERS = [name for name in shipped_cells() if name not in ("puma_pair", "ur_pair")]


@pytest.fixture(scope="module", params=OTHERS)
def other(request):
    cell = load_cell(request.param)
    return load_config(cell=cell), CellModel(cell)


@pytest.fixture
def rig(other, make_rig):
    config, model = other
    return type(make_rig())(config, model, next(iter(config.groups)), 2)


@pytest.fixture
def ends(rig):
    """Ranges of the joints, shape (n,) each."""
    return rig.all_limits.lower[rig.index], rig.all_limits.upper[rig.index]


def test_jogs_keep_limits_and_ranges(rig, ends):
    random, n = np.random.default_rng(3), len(rig.index)
    for k in range(60):
        if k % 3 == 2:
            rig.group.set_speed(float(random.choice([1.0, 0.5, 0.2])))
        else:
            joints, frame = random.uniform(-1.0, 1.0, n) * rig.limits.velocity, random.uniform(-0.4, 0.4, 6)
            asked = {"kind": "jog", "velocities": joints} if k % 3 else {"kind": "twist", "velocities": frame}
            asked |= {"velocities": asked["velocities"].tolist(), "frame": "world", "owner": "t", "lease_s": 10.0}
            rig.group.stream(rig.goal(), rig.parse("stream", **asked)[1])
        rig.ticks(int(random.integers(1, 80)))
    rig.check_motion()
    assert ((rig.q >= ends[0]) & (rig.q <= ends[1])).all()
    assert np.ptp(rig.q, axis=0).max() > 0.5


def test_trajectories_that_are_too_quick_are_re_timed_within_limits(rig, ends):
    random, span = np.random.default_rng(4), ends[1] - ends[0]
    for _ in range(4):
        q, time, points = rig.trace[-1].q, 0.0, []
        for _ in range(4):
            q = np.clip(
                q + 0.06 * random.uniform(-1.0, 1.0, len(q)) * span, ends[0] + 0.02 * span, ends[1] - 0.02 * span
            )
            time += random.uniform(0.05, 0.3)
            points.append({"time": time, "positions": q.tolist()})
        goal = rig.request({"kind": "trajectory", "points": points})
        rig.run()
        assert rig.code(goal) is None
        assert "retimed" in str(rig.results[goal][1])
        np.testing.assert_allclose(rig.trace[-1].q, q, atol=1e-9)
    rig.check_motion()


def test_lines_are_straight_or_refused(rig):
    random, frame = np.random.default_rng(5), rig.context.frames[0]
    model, done = rig.context.model, 0
    for _ in range(8):
        start, first = model.pose(rig.q_all, frame), len(rig.trace)
        end = start.translation + random.uniform(-0.06, 0.06, 3)
        pose = [*end.tolist(), *pin.Quaternion(start.rotation).coeffs().tolist()]
        goal = rig.request({"kind": "line", "poses": [pose], "blend": 0.0, "speed": 0.3})
        rig.run()
        assert rig.code(goal) in (None, "singular", "limit", "unreachable")
        done += rig.code(goal) is None
        way = (end - start.translation) / np.linalg.norm(end - start.translation)
        for setpoint in rig.trace[first::7]:
            whole = rig.q_all.copy()
            whole[rig.index] = setpoint.q
            off = model.pose(whole, frame).translation - start.translation
            assert np.linalg.norm(off - way * (off @ way)) < 5e-5
    assert done > 2
    rig.check_motion()
