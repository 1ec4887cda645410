"""The order of positions: nothing is left out, and it is short."""

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_cell.robot import load_cell
from im_cell.visit_order import BLOCKED_S, leg_times, visit_order


def length(order: list[int], times: np.ndarray) -> float:
    return float(sum(times[a, b] for a, b in pairwise(order)))


def times_of(seed: int, count: int) -> np.ndarray:
    """Distances of random places in a plane, the start among them."""
    places = np.random.default_rng(seed).uniform(size=(count + 1, 2))
    return np.linalg.norm(places[:, None] - places[None], axis=2)


@given(st.integers(0, 10_000), st.integers(0, 30))
def test_every_position_is_visited_once_from_the_start_on_and_no_exchange_saves_time(seed: int, count: int) -> None:
    times = times_of(seed, count)
    order = visit_order(times)
    assert sorted(order) == list(range(count + 1))
    assert order[0] == 0
    for i in range(1, count):
        for j in range(i + 1, count + 1):
            turned = [*order[:i], *order[i : j + 1][::-1], *order[j + 1 :]]
            assert length(turned, times) > length(order, times) - 1e-6


@pytest.mark.parametrize("seed", range(20))
def test_of_few_positions_the_order_is_hardly_longer_than_the_shortest(seed: int) -> None:
    times = times_of(seed, 6)
    shortest = min(length([0, *rest], times) for rest in permutations(range(1, 7)))
    assert length(visit_order(times), times) < 1.15 * shortest


def test_a_blocked_way_is_avoided() -> None:
    times = times_of(3, 12)
    order = visit_order(times)
    for a, b in pairwise(order):
        blocked = times.copy()
        blocked[a, b] = blocked[b, a] = times[a, b] + BLOCKED_S
        assert length(visit_order(blocked), blocked) < BLOCKED_S


def test_the_time_of_a_leg_is_the_same_there_and_back() -> None:
    joints = load_cell().joints_of("left")
    positions = np.random.default_rng(1).uniform(-0.5, 0.5, (5, len(joints))).tolist()
    times = leg_times(load_cell(), list(joints), positions)
    assert (times == times.T).all()
    assert not times.diagonal().any()
    assert (times + 9.0 * np.eye(5)).min() > 0.5
