"""Of descriptions of one net by several nodes the newest counts, until it is withdrawn."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from im_core.errors import NotFoundError
from im_pnt_display.page.descriptions import MOST_NODES, NetDescriptions

SAID = st.tuples(st.sampled_from("mn"), st.sampled_from("abc"), st.one_of(st.none(), st.integers(0, 9)))


@given(st.lists(SAID, max_size=30))
def test_the_newest_counts_of_what_is_not_withdrawn(said):
    """A number describes a net, None withdraws it."""
    descriptions, standing = NetDescriptions(), []
    for net, node, number in said:
        newest = [entry for entry in standing if entry[0] == net][-1:]
        standing = [entry for entry in standing if entry[:2] != (net, node)]
        if number is None:
            assert descriptions.withdraw(net, node) == any(entry[1] == node for entry in newest)
        else:
            descriptions.add(net, node, {"number": number})
            standing.append((net, node, number))
    for net in "mn":
        left = [entry[1:] for entry in standing if entry[0] == net]
        if left:
            node, number = left[-1]
            assert descriptions.newest(net) == (node, {"number": number})
        else:
            with pytest.raises(NotFoundError, match=f"there is no net '{net}'"):
                descriptions.newest(net)


def test_of_nodes_that_describe_one_net_the_newest_are_kept():
    descriptions = NetDescriptions()
    for number in range(MOST_NODES + 5):
        descriptions.add("m", f"node{number}", {})
    left = []
    while True:
        try:
            node, _ = descriptions.newest("m")
        except NotFoundError:
            break
        left.append(node)
        descriptions.withdraw("m", node)
    assert left == [f"node{number}" for number in reversed(range(5, MOST_NODES + 5))]
