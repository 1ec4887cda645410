"""Whose word it is which places a net has."""

import pytest

from im_core.errors import NotFoundError, StateError
from im_dom import places as module
from im_dom.places import Places

ONE, TWO = '{"places": ["one"]}', '{"places": ["one", "two"]}'


def test_a_net_that_another_node_has_taken_over_stays_whatever_the_former_one_says() -> None:
    places = Places()
    places.describe("n", "/former", ONE)
    places.describe("n", "/present", TWO)
    places.describe("n", "/former", "")
    places.require("n.two")
    places.describe("n", "/present", "")
    assert "n" not in places
    with pytest.raises(NotFoundError, match="there is no net 'n'"):
        places.require("n.two")


def test_so_many_nets_are_known_and_those_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_NETS", 2)
    places = Places()
    for net in ("a", "b"):
        places.describe(net, "/node", ONE)
    with pytest.raises(StateError, match="net c is not learned: 2 others are known"):
        places.describe("c", "/node", ONE)
    places.describe("b", "/node", TWO)
    places.require("b.two")
    places.describe("a", "/node", "")
    places.describe("c", "/node", ONE)
