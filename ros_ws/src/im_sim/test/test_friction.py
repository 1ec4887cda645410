import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st

from im_sim.actuators import DryFriction


def problem(rng, n):
    root = rng.normal(size=(n, n))
    inertia = root @ root.T + np.diag(10.0 ** rng.uniform(-2, 1, n))
    bounds = 10.0 ** rng.uniform(-2, 1, (2, n)) * rng.integers(0, 2, (2, n))
    return inertia, rng.normal(size=n), *bounds


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 18))
@example(97, 13)  # block pivots alone go round in circles here
def test_the_solution_satisfies_the_law_of_dry_friction(seed, n):
    rng = np.random.default_rng(seed)
    friction = DryFriction(n)
    for _ in range(3):  # the pivots of one problem are the start of the next
        inertia, momentum, p_positive, p_negative = problem(rng, n)
        friction.bound(p_positive, p_negative)
        v = friction.solve(inertia, momentum)
        p = inertia @ v - momentum
        tolerance = 1e-9 * (1.0 + np.abs(momentum).max())
        np.testing.assert_allclose(p[v > 0.0], -p_positive[v > 0.0], atol=tolerance)
        np.testing.assert_allclose(p[v < 0.0], p_negative[v < 0.0], atol=tolerance)
        assert (p <= p_negative + tolerance).all()
        assert (p >= -p_positive - tolerance).all()
        assert friction.stuck == (v == 0.0).all()


def test_a_held_mass_does_not_move_and_a_pushed_one_does():
    friction, one = DryFriction(1), np.eye(1)
    friction.bound(np.array([1.0]), np.array([2.0]))
    assert friction.solve(one, np.array([0.9])) == 0.0
    assert friction.solve(one, np.array([1.5])) == 0.5
    assert friction.solve(one, np.array([-1.5])) == 0.0
    assert friction.solve(one, np.array([-2.5])) == -0.5
