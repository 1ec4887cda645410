"""Short ways between poses: the order and the configurations, against every other choice."""

from itertools import combinations, pairwise, permutations

import numpy as np
import pytest

from im_mcs.poses.short_ways import ROUNDS, ShortWays

START = np.zeros(2)


def distances(a, b):
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def length(places):
    return sum(float(np.linalg.norm(a - b)) for a, b in pairwise([START, *places]))


def known(configurations):
    """Each pose has a fixed list of configurations."""
    return lambda rank, q, spread: configurations[rank]


@pytest.mark.parametrize("seed", range(12))
def test_neither_another_order_nor_another_configuration_of_one_pose_is_shorter(seed):
    configurations = np.random.default_rng(seed).uniform(-1.0, 1.0, (5, 3, 2))
    ways = ShortWays(distances, known(configurations), lambda a, b: True)
    found = ways.shorten(START, list(configurations[:, 0]), lambda told: None)
    assert sorted(rank for rank, _ in found) == list(range(5))
    assert all((configurations[rank] == q).all(axis=1).any() for rank, q in found)
    places = [q for _, q in found]
    shortest = length(places) - 1e-6
    assert all(length(list(order)) > shortest for order in permutations(places) if turned(order, places))
    for place, (rank, _) in enumerate(found):
        for other in configurations[rank]:
            assert length([*places[:place], other, *places[place + 1 :]]) > shortest


def turned(order, places):
    """Whether an order is the one of ``places`` with one part turned round."""
    ranks = [next(rank for rank, place in enumerate(places) if place is each) for each in order]
    return any(
        ranks == [*range(a), *range(b - 1, a - 1, -1), *range(b, len(places))]
        for a, b in combinations(range(len(places) + 1), 2)
    )


def test_a_blocked_way_is_gone_only_where_there_is_no_other():
    near, far = np.array([0.1, 0.0]), np.array([0.0, 1.0])

    def free(a, b):
        return not (np.array_equal(a, START) and np.array_equal(b, near))

    ways = ShortWays(distances, known([np.array([near, far])]), free)
    ((_, q),) = ways.shorten(START, [near], lambda told: None)
    assert np.array_equal(q, far)
    ((_, q),) = ShortWays(distances, known([near[None]]), free).shorten(START, [near], lambda told: None)
    assert np.array_equal(q, near)


def test_each_round_tells_a_time_that_is_no_longer_than_the_one_before():
    rng, told = np.random.default_rng(3), list[str]()
    first = list(rng.uniform(-1.0, 1.0, (6, 2)))
    ways = ShortWays(distances, lambda rank, q, spread: q + spread * rng.normal(size=(20, 2)), lambda a, b: True)
    found = ways.shorten(START, first, told.append)
    times = [float(sentence.split(": ")[1].split()[0]) for sentence in told]
    assert 1 < len(times) <= ROUNDS
    assert times == sorted(times, reverse=True)
    assert length([q for _, q in found]) < length(first)
