"""Free bodies and allowed contacts: the monitor keeps away from the ones, and heeds the leases of the others."""

import numpy as np
import pytest

from im_core.errors import ImError
from im_mcs.collision import NOTHING, AllowedContact, CollisionChecker, CollisionScene, Thing

UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def block_in_the_way(model, cell, turn):
    """A block where the left hand would come, if the arm turned that far."""
    q = cell.home.copy()
    q[3] += turn
    hand = model.seen_from(q, "left_wrist", (0.0, 0.0, 0.1, *UPRIGHT), "world")
    return Thing.checked("block", "box", (0.1, 0.1, 0.1), "world", (*hand[:3], *UPRIGHT))


def told(thing, *contacts):
    return {"things": [thing.model_dump()], "contacts": [contact.model_dump() for contact in contacts]}


def test_a_motion_towards_a_free_body_is_stopped_and_is_free_when_that_is_gone(bench, model, cell):
    bench.to_motion("left")
    goal = cell.home[:9].copy()
    goal[3] += 1.2
    block = block_in_the_way(model, cell, 0.9)
    assert bench.ask("surround", **told(block))["success"]
    reply = bench.move("left", goal)
    assert reply["error"]["code"] == "collision"
    assert "block" in reply["error"]["message"]
    assert bench.move("left", cell.home[:9])["success"], "the way back"
    assert bench.ask("surround")["success"]
    assert bench.move("left", goal)["success"]


def test_a_contact_is_allowed_until_its_lease_ends(bench, model, cell):
    bench.to_motion("left")
    goal = cell.home[:9].copy()
    goal[3] += 1.2
    block = block_in_the_way(model, cell, 0.9)
    links = [capsule.link for capsule in cell.bodies if capsule.link.startswith("left")]
    ends = bench.mcs.measured.stamp_ns + 60_000_000_000
    allowed = [AllowedContact(first=link, second="block", until_ns=ends) for link in dict.fromkeys(links)]
    assert bench.ask("surround", **told(block, *allowed))["success"]
    assert bench.move("left", goal)["success"]
    short = [contact.model_copy(update={"until_ns": bench.mcs.measured.stamp_ns + 1}) for contact in allowed]
    assert bench.ask("surround", **told(block, *short))["success"]
    assert not bench.move("left", cell.home[:9])["success"], (
        "the lease has ended: back through the block it does not go"
    )


def test_what_is_carried_moves_with_its_wrist(model, cell, config):
    q = cell.home.copy()
    there = model.seen_from(q, "left_wrist", (0.0, 0.0, 0.2, *UPRIGHT), "world")
    back = model.seen_from(q, "world", there, "left_wrist")
    assert back == pytest.approx((0.0, 0.0, 0.2, *UPRIGHT), abs=1e-9)
    bar = Thing.checked("bar", "box", (4.0, 0.04, 0.04), "left_wrist", back)
    checker = CollisionChecker(model, config.collision.clearance_m, CollisionScene((bar,)))
    with pytest.raises(ImError, match="would collide with bar"):
        checker.require_free(q)


def test_changes_make_new_surroundings_and_wrong_ones_are_sentences():
    pose = (0.0, 0.0, 1.0, *UPRIGHT)
    can = Thing.checked("can", "cylinder", (0.06, 0.06, 0.1), "world", pose)
    around = NOTHING.with_thing(can).with_contact(AllowedContact(first="can", second="table", until_ns=5))
    assert around.allowed == {frozenset(("can", "table"))}
    assert around.at(4) is around
    assert around.at(5) == CollisionScene((can,))
    assert around.without("can") == NOTHING, "its contacts are gone with it"
    for wrong, why in (
        (lambda: around.without("cup"), "there is no object 'cup'"),
        (lambda: around.with_contact(AllowedContact(first="can", second="can", until_ns=1)), "'can' was named twice"),
        (lambda: Thing.checked("can", "ball", (1, 1, 1), "world", pose), "'can': kind: 'ball'"),
        (lambda: Thing.checked("can", "box", (1, 0, 1), "world", pose), r"'can': size\[1\]"),
        (lambda: Thing.checked("can", "box", (1, 1, 1), "world", (0.0,) * 7), "quaternion x y z w of norm 1"),
        (lambda: Thing.checked("can", "box", (1, 1, 1), "world", (np.nan, *pose[1:])), "'can': pose"),
    ):
        with pytest.raises(ImError, match=why):
            wrong()
    with pytest.raises(ImError, match="'one' is one too many: 16 objects are allowed"):
        CollisionScene(tuple(can.model_copy(update={"name": str(k)}) for k in range(16))).with_thing(
            can.model_copy(update={"name": "one"})
        )
