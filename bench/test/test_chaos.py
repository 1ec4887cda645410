"""What the chaos bench takes for true, false and left behind; the machine itself is tested end to end."""

from random import Random

import pytest

from bench.chaos.__main__ import table
from bench.chaos.command import Outcome
from bench.chaos.faults import KINDS, ROLES, kill, stop
from bench.chaos.trial import Result, Verdict, judge

SERVO, TWO = kill(("servo",)), kill(("dom", "mcs"))


def ended(code, said="", **report):
    return Outcome(code, said, report, 0.0)


@pytest.mark.parametrize(
    ("fault", "outcome", "verdict"),
    [
        (SERVO, ended(0, chi2_per_dof=1.1), Verdict.SUCCESS),
        (SERVO, ended(0, chi2_per_dof=40.0), Verdict.FALSE),
        (SERVO, ended(0), Verdict.FALSE),
        (SERVO, ended(None), Verdict.HANG),
        (SERVO, ended(1, "the process im_mcs.servo ended with code -9"), Verdict.TRUE_REASON),
        (SERVO, ended(1, "dom is missing (last heard 6.1 s ago)"), Verdict.FALSE),
        (TWO, ended(1, "dom is missing (last heard 6.1 s ago)"), Verdict.TRUE_REASON),
        (SERVO, ended(1), Verdict.FALSE),
    ],
)
def test_a_command_ends_true_if_it_succeeds_or_names_who_failed(fault, outcome, verdict):
    assert judge(fault, outcome) is verdict
    assert verdict.failure == (verdict not in (Verdict.SUCCESS, Verdict.TRUE_REASON))


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_repeats_a_fault(kind):
    drawn = [str(KINDS[kind](Random(seed), ROLES)) for seed in range(50)]
    assert [str(KINDS[kind](Random(seed), ROLES)) for seed in range(50)] == drawn


def test_seeds_reach_every_role_and_two_are_two():
    assert {KINDS["kill"](Random(seed), ROLES).victims for seed in range(500)} == {(role,) for role in ROLES}
    assert all(len(set(KINDS["kill-two"](Random(seed), ROLES).victims)) == 2 for seed in range(50))


def test_the_table_tells_every_fault_and_the_slowest_recovery():
    results = [
        Result(1, SERVO, Verdict.SUCCESS, "", 2.0),
        Result(2, SERVO, Verdict.TRUE_REASON, "servo", 4.0),
        Result(3, stop(("dom",), 15.0), Verdict.LOST, "dom", None),
    ]
    head, stopped, killed, summary = table(results).splitlines()
    assert head.split()[:2] == ["fault", "success"]
    assert stopped.split()[:4] == ["SIGSTOP", "15", "s", "dom"]
    assert killed.split()[-1] == "4.0"
    assert summary.endswith("most 4.0 s, 67% within 15 s")
