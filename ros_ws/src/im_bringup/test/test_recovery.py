"""Which step brings the machine nearer to ready."""

import pytest

from im_bringup.machine.recovery import McsCondition, Step, next_step

UP = {"testbed": "ready", "mcs": "ready"}


def mcs(state, reason="", stale=False, faulty=False):
    return McsCondition(state, reason, stale, faulty)


@pytest.mark.parametrize(
    ("condition", "patient", "step"),
    [
        (mcs("cold"), True, Step.DONE),
        (mcs("motion"), True, Step.DONE),
        (mcs("unconfigured", faulty=True), True, Step.CONFIGURE),
        (mcs("estopped", "a fault", faulty=True), True, Step.RESET),
        (mcs("motion", "the servo process hangs", faulty=True), True, Step.WAIT),  # it may wake
        (mcs("motion", "the servo process hangs", faulty=True), False, Step.RESTART),
        (mcs("estopped", "a fault"), False, Step.RESTART),  # a reset has not helped
        (mcs("unconfigured"), False, Step.RESTART),
        (mcs("cold", stale=True), False, Step.WAIT),  # nobody would hear a request
        (None, False, Step.WAIT),
    ],
)
def test_what_mcs_needs(condition, patient, step):
    assert next_step(UP, condition, patient) is step


@pytest.mark.parametrize("word", ["starting", "loaded", "configured", "stopping", "failed", "dead"])
def test_tasks_come_first(word):
    assert next_step({**UP, "testbed": word}, mcs("unconfigured"), patient=False) is Step.WAIT


def test_a_machine_that_was_not_heard_yet_is_not_ready():
    assert next_step({}, mcs("cold"), patient=True) is Step.WAIT


def test_a_machine_without_motion_control_needs_none():
    assert next_step({"dom": "ready"}, None, patient=True) is Step.DONE
