"""Gaps in the numbers of messages, where nobody says whose they are."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bag.numbers import Numbers
from bench.bag.recording import recorded
from im_bag import BagWriter, Delivery, PartLimits


def gaps(numbers, before, known):
    taken = Numbers()
    for number in numbers:
        taken.take(number)
    return taken.gaps(before, known)


@pytest.mark.parametrize(
    ("numbers", "before", "known", "found"),
    [
        ([1, 2, 3], 0, 1, 0),
        ([7, 8, 9], 1, 1, 0),
        ([1, 2, 4, 5], 0, 1, 1),
        ([7, 9, 11], 1, 1, 2),
        ([5, 1, 6, 2, 3, 7], 1, 2, 0),  # one was there, another has come
        ([5, 1, 6, 2, 4, 7], 1, 2, 1),
        ([5, 6, 3, 4, 7], 1, 2, 0),  # its first ones were sent before anybody listened
        ([5, 1, 6, 1, 7, 1], 1, 1, 0),  # others came and went, and nobody has seen them
    ],
)
def test_a_message_that_goes_on_with_nobodys_numbers_is_of_a_new_publisher_or_follows_a_gap(
    numbers, before, known, found
):
    assert gaps(numbers, before, known) == found


PUBLISHERS = st.lists(st.tuples(st.integers(1, 20), st.integers(1, 12)), min_size=1, max_size=4)


@given(PUBLISHERS, st.randoms(use_true_random=False))
def test_however_publishers_interleave_nothing_is_missing(publishers, draw):
    left = [list(range(first, first + count)) for first, count in publishers]
    mixed = []
    while left := [numbers for numbers in left if numbers]:
        mixed.append(draw.choice(left).pop(0))
    assert gaps(mixed, len(publishers), len(publishers)) == 0


@given(st.integers(1, 5), st.integers(2, 30), st.data())
def test_a_message_that_is_lost_among_publishers_at_different_numbers_is_one_gap(count, length, data):
    """Each has numbers of its own here, so that none can stand for another's."""
    lost = data.draw(st.integers(1, length - 1)) if length > 2 else 1
    streams = [[1000 * own + number for number in range(length)] for own in range(1, count + 1)]
    whole = [number for moment in zip(*streams, strict=True) for number in moment]
    missing = [number for number in whole if number != streams[0][lost]]
    assert gaps(whole, count, count) == 0
    assert gaps(missing, count, count) == (1 if lost < length - 1 else 0)


def test_the_numbers_are_read_from_all_parts_of_a_bag_in_their_order(tmp_path):
    bag = BagWriter(tmp_path / "bag", PartLimits(time_ns=5 * 10**9))
    for topic in ("/whole", "/cut"):
        bag.add_topic(topic, "std_msgs/msg/String", Delivery(reliable=True, latched=False, depth=10), "")
    for number in range(1, 61):
        for topic in ("/whole", "/cut"):
            if (topic, number) != ("/cut", 30):
                bag.write(topic, number * 10**9, b"\0\1\0\0\1\0\0\0\0", number * 10**9, number)
    bag.close()
    assert len(list((tmp_path / "bag").glob("*.mcap"))) > 10
    topics, duration_s = recorded(tmp_path / "bag")
    assert {topic: numbers.gaps(1, 1) for topic, numbers in topics.items()} == {"/whole": 0, "/cut": 1}
    assert (topics["/cut"].count, duration_s) == (59, pytest.approx(59.0))
