"""States per group: two clients, each with groups of its own, at one state manager."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_core.errors import ImError
from im_mcs.limits.configuration import load_config
from im_mcs.protocol.requests import Sender
from im_mcs.state import POWERED, TABLE, Event, State
from im_mcs.state.manager import StateManager
from im_mcs.state.table import TRANSITIONS, highest
from im_mcs.testbed import Measured

JOINTS = {"left": ("l1", "l2"), "right": ("r1",), "third": ("t1", "t2")}
NAMES = [joint for joints in JOINTS.values() for joint in joints]
INDEX = {group: np.array([NAMES.index(joint) for joint in joints]) for group, joints in JOINTS.items()}
ROWS = {(row.source, row.event): row.target for row in TABLE}
SETTINGS = load_config().servo
ENOUGH = 4 * SETTINGS.brake_lead_ticks + 10


class StillArms:
    """Layers above the slots that note who is engaged; nothing moves, all settle at once."""

    def __init__(self):
        self.engaged, self.goals, self.ended = set(), set(), []

    def engage(self, groups):
        assert not self.engaged & set(groups)  # an arm that is held is not taken hold of anew
        self.engaged |= set(groups)

    def disengage(self, groups):
        self.engaged -= set(groups)

    def drop_goals(self, reason):
        self.engaged.clear()
        self.goals.clear()

    def end_goals(self, groups, reason):
        self.ended += [(group, reason.message) for group in groups if group in self.goals]
        self.goals -= set(groups)

    def moving(self, groups):
        return next((group for group in groups if group in self.goals), None)

    def settled(self, groups):
        return True

    def forget_stop(self) -> None: ...

    def broken(self):
        return []


@dataclass
class Rig:
    """A state manager over a testbed that obeys in the tick after."""

    arms: StillArms = field(default_factory=StillArms)
    tick: int = 0
    asked: int = 0
    answers: dict = field(default_factory=dict)

    def __post_init__(self):
        self.manager = StateManager(NAMES, JOINTS, INDEX, SETTINGS, self.measured(False, np.ones(5, bool)), self.arms)

    def measured(self, power, brakes):
        none = np.zeros(0)
        held = brakes | (not power)
        return Measured(self.tick, self.tick * 4_500_000, np.zeros(5), power, held, none, np.zeros(5), none, none)

    def ticks(self, count):
        for _ in range(count):
            self.tick += 1
            manager = self.manager
            manager.measured = self.measured(manager.power, manager.brakes.copy())
            manager.tick()

    def ask(self, event, client, group=""):
        """Ask as a client; the number of the question."""
        self.asked += 1
        number, manager, sender = self.asked, self.manager, Sender(names=[client])

        def reply(error):
            assert number not in self.answers
            self.answers[number] = error

        try:
            if event in TRANSITIONS:
                manager.begin(event, reply, group, sender)
                return number
            match event:
                case Event.RESERVE:
                    manager.reserve(group, client, 0.0, sender)
                case Event.RELEASE:
                    manager.release(group, sender, reply)
                    return number
                case Event.TAKE_OVER:
                    manager.take_over(group, client, 0.0, sender)
                case Event.RESET:
                    manager.reset(reply)
                    return number
                case Event.ESTOP:
                    manager.estop("at random")
        except ImError as error:
            reply(error)
        else:
            reply(None)
        return number

    def result(self, event, client, group=""):
        """As :meth:`ask`, to the end: None, or the sentence of the refusal."""
        number = self.ask(event, client, group)
        self.ticks(ENOUGH)
        error = self.answers[number]
        return None if error is None else error.message

    def up(self, client, group, state=State.MOTION):
        for event in (Event.RESERVE, Event.POWER_ON, Event.ENABLE_MOTION)[: list(State).index(state) - 1]:
            assert self.result(event, client, group) is None
        assert self.manager.state_of(group) is state
        return self


def states(rig):
    return {group: rig.manager.state_of(group) for group in JOINTS}


@pytest.mark.parametrize("other", [State.COLD, State.RESERVED, State.ACTIVE, State.MOTION])
@pytest.mark.parametrize(("source", "event"), [row for row in ROWS if row[1] in TRANSITIONS | {Event.RELEASE}])
def test_a_row_leads_one_group_on_whatever_state_another_is_in(source, event, other):
    rig = Rig().up("bob", "right", other).up("ann", "left", source)
    assert rig.result(event, "ann", "left") is None
    assert states(rig) == {"left": ROWS[source, event], "right": other, "third": State.COLD}
    assert rig.manager.state is highest((ROWS[source, event], other))
    assert rig.manager.power == any(state in POWERED for state in states(rig).values())


@pytest.mark.parametrize("state", [State.RESERVED, State.ACTIVE, State.MOTION])
def test_nobody_but_its_owner_changes_power_or_motion_of_a_group(state):
    rig = Rig().up("ann", "left", state)
    for event in (event for source, event in ROWS if source is state and event in TRANSITIONS):
        for group in ("left", ""):  # by name, and as a Trigger, which has none
            said = rig.result(event, "eve", group)
            assert "group 'left' is driven by its owner 'ann' only, not by 'eve'" in said
    rig.up("eve", "right", State.RESERVED)
    for event in TRANSITIONS - {Event.POWER_ON}:
        said = rig.result(event, "eve")
        assert said.startswith(f"{event.value} is refused in state reserved; allowed here: "), said
    assert states(rig) == {"left": state, "right": State.RESERVED, "third": State.COLD}


def test_a_request_without_a_group_is_for_those_of_the_caller_that_it_leads_on():
    rig = Rig().up("ann", "left").up("ann", "right", State.RESERVED).up("bob", "third", State.RESERVED)
    assert rig.result(Event.POWER_ON, "ann") is None
    assert states(rig) == {"left": State.MOTION, "right": State.ACTIVE, "third": State.RESERVED}
    rig.arms.goals = {"left"}
    assert rig.result(Event.ENABLE_MOTION, "ann") is None
    assert rig.result(Event.DISABLE_MOTION, "ann") is None
    assert rig.arms.ended == [("left", "the motion was ended: motion of its group is being disabled")]
    assert rig.result(Event.POWER_OFF, "ann") is None
    assert states(rig) == dict.fromkeys(JOINTS, State.RESERVED)
    assert not rig.manager.power


def test_power_stays_while_a_group_needs_it_and_goes_with_the_last():
    rig = Rig().up("ann", "left", State.ACTIVE).up("bob", "right")
    rig.arms.goals = {"right"}
    before = rig.manager.brakes.copy()
    assert rig.result(Event.POWER_OFF, "ann", "left") is None
    assert rig.manager.power
    assert (rig.manager.brakes == before).all()
    assert rig.result(Event.RELEASE, "ann", "left") is None
    assert states(rig) == {"left": State.COLD, "right": State.MOTION, "third": State.COLD}
    rig.arms.goals = set()
    for event in (Event.DISABLE_MOTION, Event.POWER_OFF):
        assert rig.result(event, "bob", "right") is None
    assert not rig.manager.power


def test_power_that_is_asked_for_while_it_goes_comes_back():
    rig = Rig().up("ann", "left", State.ACTIVE).up("bob", "right", State.RESERVED)
    off, on = rig.ask(Event.POWER_OFF, "ann", "left"), rig.ask(Event.POWER_ON, "bob", "right")
    rig.ticks(ENOUGH)
    assert rig.answers == {**rig.answers, off: None, on: None}
    assert states(rig) == {"left": State.RESERVED, "right": State.ACTIVE, "third": State.COLD}
    assert rig.manager.power


def test_transitions_of_two_groups_go_on_beside_each_other():
    rig = Rig().up("ann", "left", State.ACTIVE).up("bob", "right", State.ACTIVE)
    first = rig.ask(Event.ENABLE_MOTION, "ann", "left")
    rig.ticks(1)
    second = rig.ask(Event.ENABLE_MOTION, "bob", "right")
    assert rig.arms.engaged == {"left"}
    assert rig.result(Event.RESERVE, "eve", "third") is None
    assert rig.answers[first] is None
    assert rig.answers[second] is None
    assert rig.arms.engaged == {"left", "right"}


def test_an_emergency_stop_ends_the_transitions_of_all_groups():
    rig = Rig().up("ann", "left", State.ACTIVE).up("bob", "right").up("eve", "third", State.RESERVED)
    under_way = rig.ask(Event.ENABLE_MOTION, "ann", "left"), rig.ask(Event.POWER_ON, "eve", "third")
    rig.manager.estop("a hand")
    assert all("emergency stop: a hand" in rig.answers[number].message for number in under_way)
    assert states(rig) == dict.fromkeys(JOINTS, State.ESTOPPED)
    assert not rig.manager.power
    assert rig.manager.brakes.all()
    rig.ticks(2)
    assert rig.result(Event.RESET, "eve") is None
    assert states(rig) == dict.fromkeys(JOINTS, State.COLD)
    assert rig.manager.reservations.groups == ()


def test_a_brake_that_does_not_obey_fails_its_group_alone():
    rig = Rig().up("bob", "right").up("ann", "left", State.ACTIVE)
    number, obeys = rig.ask(Event.ENABLE_MOTION, "ann", "left"), rig.measured

    def measured(power, brakes):
        brakes[0] = True
        return obeys(power, brakes)

    rig.measured = measured
    rig.ticks(2 * round(SETTINGS.answer_timeout_s / SETTINGS.period_s) + ENOUGH)
    assert "the brakes to release, those of l1, in vain" in rig.answers[number].message
    assert states(rig) == {"left": State.ACTIVE, "right": State.MOTION, "third": State.COLD}
    assert rig.arms.engaged == {"right"}


def test_who_is_given_up_on_is_braked_by_anybody_and_freed():
    rig = Rig()
    rig.manager.reserve("left", "ann", 1.0, Sender(names=["ann"]))
    for event in (Event.POWER_ON, Event.ENABLE_MOTION):
        assert rig.result(event, "ann", "left") is None
    rig.up("bob", "right")
    assert "its owner 'ann' only" in rig.result(Event.DISABLE_MOTION, "bob", "left")
    rig.ticks(round(1.0 / SETTINGS.period_s))
    assert rig.result(Event.DISABLE_MOTION, "eve", "left") is None
    assert "its owner 'ann' only" in rig.result(Event.ENABLE_MOTION, "eve", "left")
    assert rig.result(Event.POWER_OFF, "eve", "left") is None
    assert states(rig) == {"left": State.COLD, "right": State.MOTION, "third": State.COLD}


EVENTS = [*sorted(TRANSITIONS), Event.RESERVE, Event.RELEASE, Event.TAKE_OVER, Event.ESTOP, Event.RESET]
REQUESTS = st.tuples(
    st.sampled_from(["ann", "bob"]),
    st.sampled_from(EVENTS),
    st.sampled_from([*JOINTS, ""]),
    st.integers(0, 12) | st.just(ENOUGH),
    st.integers(0, 3),
)


def drawn(rig, client, event, group, sense):
    """A request: as it was drawn, or, three times of four, one that the owner of a group may ask in its state."""
    if not sense or not group:
        return client, event, group
    state, held = rig.manager.state_of(group), rig.manager.reservations.of(group)
    onwards = [e for e in EVENTS if (state, e) in ROWS and e not in (Event.ESTOP, Event.TAKE_OVER)]
    return held.owner if held else client, onwards[EVENTS.index(event) % len(onwards)], group


def may(rig, event, client, group):
    """What a request to a quiet machine leads to, by the table and the owners alone: states by group; None: refused."""
    before, owners = states(rig), {g: rig.manager.reservations.of(g) for g in JOINTS}
    if event is Event.ESTOP:
        return dict.fromkeys(JOINTS, State.ESTOPPED)
    if event is Event.RESET:
        obeyed = not rig.manager.measured.power
        return dict.fromkeys(JOINTS, State.COLD) if rig.manager.state is State.ESTOPPED and obeyed else None
    ours = [g for g in JOINTS if event in (Event.RESERVE, Event.TAKE_OVER) or (owners[g] and owners[g].owner == client)]
    asked = [group] if group else list(JOINTS) if event in TRANSITIONS else []
    led = {g: ROWS[before[g], event] for g in asked if g in ours and (before[g], event) in ROWS}
    return {**before, **led} if led else None


@settings(max_examples=200, deadline=None)
@given(st.lists(REQUESTS, max_size=40))
def test_whatever_two_clients_ask_a_group_goes_by_the_table_and_for_its_owner(requests):
    rig = Rig()
    manager = rig.manager
    for *request, delay, sense in requests:
        client, event, group = drawn(rig, *request, sense)
        before, owners = states(rig), {g: manager.reservations.of(g) for g in JOINTS}
        quiet = not manager.busy and (delay == ENOUGH or event is Event.ESTOP)
        expected = may(rig, event, client, group) if quiet else None
        number = rig.ask(event, client, group)
        for _ in range(delay):
            was = states(rig)
            rig.ticks(1)
            judge(rig, was)
        if quiet and delay == ENOUGH:
            assert (rig.answers[number] is None) == (expected is not None), rig.answers[number]
            assert states(rig) == (before if expected is None else expected)
        if number in rig.answers and rig.answers[number] is not None and quiet:
            assert {g: manager.reservations.of(g) for g in JOINTS} == owners
            assert len(rig.answers[number].message) > 20
    rig.ticks(ENOUGH)
    assert not manager.busy
    assert sorted(rig.answers) == list(range(1, rig.asked + 1))  # each is answered, once


def judge(rig, was):
    """What holds in every tick."""
    manager, now = rig.manager, states(rig)
    assert manager.state is highest(now.values())
    for group, state in now.items():
        row = [event for (source, event), target in ROWS.items() if (source, target) == (was[group], state)]
        assert state is was[group] or row or state is State.COLD
        under_way = group in manager.under_way()
        if state is State.MOTION:
            assert manager.power
            assert group in rig.arms.engaged
        elif not under_way:
            assert manager.brakes[INDEX[group]].all()
            assert group not in rig.arms.engaged
        if not under_way:
            assert (state in POWERED) <= manager.power
    if not manager.busy:
        assert manager.power == any(state in POWERED for state in now.values())
