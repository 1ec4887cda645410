"""What the chaos bench takes for true, false and left behind; the machine itself is tested end to end."""

from random import Random
from types import SimpleNamespace

import numpy as np
import pytest

from bench.chaos import __main__ as chaos
from bench.chaos import history, over_hosts
from bench.chaos.command import Outcome
from bench.chaos.faults import KINDS, ROLES, kill, stop
from bench.chaos.records import BEGIN, END, Result, Verdict, append, document, read, table
from bench.chaos.safety import Braking, Rest, Uncontrolled, Watch
from bench.chaos.trial import judge
from im_cell.link import ControlState, Drive
from im_cell.robot import load_cell
from im_core.files import FileError
from im_sim.actuators import Actuators
from im_sim.brakes import HoldingBrakes
from im_sim.plant import Plant

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
        (TWO, ended(1, "there is no data object 'dom/1/spots'; did you mean 'x'? (known: dom/1/mcs)"), Verdict.FALSE),
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


def result(seed, fault, verdict, said, recovery_s):
    return Result(seed, 0.0, fault.kind, str(fault), verdict, said, recovery_s)


RESULTS = [
    result(1, SERVO, Verdict.SUCCESS, "", 2.0),
    result(2, SERVO, Verdict.TRUE_REASON, "servo", 4.0),
    result(3, stop(("dom",), 15.0), Verdict.LOST, "dom", None),
]


def test_the_table_tells_every_fault_and_the_slowest_recovery():
    head, stopped, killed, summary = table(RESULTS).splitlines()
    assert head.split()[:2] == ["fault", "success"]
    assert stopped.split()[:4] == ["SIGSTOP", "15", "s", "dom"]
    assert killed.split()[-1] == "4.0"
    assert summary.startswith("3 injections (3 at factor 0), 1 failures")
    assert summary.endswith("most 4.0 s, 66.7% within 15 s (bar 95%)")


def test_runs_accumulate_in_a_file_from_which_the_documentation_is_written(tmp_path):
    file, page = tmp_path / "chaos.jsonl", tmp_path / "page.md"
    for each in RESULTS:
        append(file, each)
    assert read(file) == RESULTS
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    document(read(file), page)
    text = page.read_text(encoding="utf-8")
    assert text.startswith("before\n")
    assert text.endswith("after\n")
    assert "old" not in text
    assert "| kill -9 | 2 | 1 | 1 | 0 | 4.0 |" in text


def test_a_line_that_is_no_result_is_named(tmp_path):
    file = tmp_path / "chaos.jsonl"
    append(file, RESULTS[0])
    with file.open("a", encoding="utf-8") as lines:
        lines.write('{"seed": 2}\n')
    with pytest.raises(FileError, match=r"chaos\.jsonl:2: is no line of a chaos run"):
        read(file)


PERIOD_S, JOINTS = 0.0045, ("left_j1", "left_j2")
STILL, MOVING = np.zeros(2), np.array([0.0, -0.24])


def control(tick, servo=7, losses=0, power=True, braked=False):
    return ControlState(tick, servo, losses, power, braked)


def test_arms_that_keep_their_power_may_move_for_half_a_second_and_no_longer():
    rest = Rest(control(1000), JOINTS, PERIOD_S)
    assert rest.finding(control(1000 + 100), MOVING) == ""
    assert rest.finding(control(1000 + 120), STILL) == ""
    assert rest.finding(control(1000 + 120), MOVING) == "0.54 s after the fault left_j2 still moves, -0.240"
    assert rest.finding(control(5000, servo=0, losses=1, power=False), MOVING) == "", "brakes stop it"


@pytest.mark.parametrize("taken_over", [{"servo": 8, "losses": 1}, {"servo": 8}, {"losses": 1}])
def test_the_motion_of_the_next_command_is_none_of_the_fault_before_it(taken_over):
    rest = Rest(control(1000), JOINTS, PERIOD_S)
    assert rest.finding(control(1001, servo=0, losses=1, power=False, braked=True), STILL) == ""
    assert rest.finding(control(1120, **taken_over), MOVING) == ""
    assert rest.over


def test_without_a_servo_power_is_off_from_the_second_tick_on():
    rule = Uncontrolled()
    assert rule.finding(control(10)) == ""
    assert rule.finding(control(11, servo=0)) == ""
    assert rule.finding(control(13, servo=0, power=False)) == ""
    assert rule.finding(control(13, servo=0)) == "2 ticks without a servo, and the power is on"
    assert rule.finding(control(14)) == rule.finding(control(15, servo=0)) == ""


CELL = load_cell()


class WeakBrakes:
    """The cell, but for a share of the stated torque of its brakes."""

    def __init__(self, share):
        self._share = share

    def __getattr__(self, name):
        return getattr(CELL, name)

    def per_joint(self, attribute):
        return CELL.per_joint(attribute) * (self._share if attribute == "brake" else 1.0)


def stopped(share, delay_s=CELL.brakes.delay):
    """Whether arms at half speed come to rest by brakes that have a share of their stated torque; what is found."""
    plant, rule = Plant(CELL, seed=1), Braking(CELL, CELL.period)
    plant._actuators = Actuators(WeakBrakes(share), plant._dynamics, plant._dt)
    plant._brakes = HoldingBrakes(18, round(delay_s / CELL.period))
    for _ in range(60):  # the brakes let go
        plant.run_tick(Drive(np.zeros(18), True, np.zeros(18, dtype=bool), np.zeros(2), True, np.zeros(2)))
    plant._world.reset(CELL.home, 0.5 * CELL.per_joint("limits.velocity"))
    plant.q, plant.v = plant._world.state()
    findings = []
    for tick in range(300):
        plant.run_tick(None)
        told = ControlState(tick, 0, 1, plant.power, bool(plant.brakes.all()))
        findings.append(rule.finding(told, plant.q, plant.v))
    plant.close()
    return np.abs(plant.v).max() < 1e-9, next(filter(None, findings), "")


def test_a_joint_is_too_fast_with_power_alone_for_without_it_gravity_drives_until_the_brakes_hold():
    fast = np.zeros(18)
    fast[CELL.joint_names.index("left_tilt")] = 0.7
    findings = []
    for power in (True, False):
        watch = Watch()
        watch._look(control(1000, servo=7, power=power), PERIOD_S, SimpleNamespace(q=CELL.home, v=fast))
        findings.append(watch.take_findings())
    assert findings == [["faster than its limit: left_tilt 0.70"], []]


def test_arms_travel_as_far_as_their_brakes_let_them():
    assert stopped(1.0) == (True, "")
    assert "travelled" in stopped(0.7)[1], "brakes weaker than stated"
    assert "ticks without power, and not every brake holds" in stopped(1.0, delay_s=2.0 * CELL.brakes.delay)[1]


def test_a_motor_that_drives_against_the_brakes_is_seen():
    rule, q, v = Braking(CELL, CELL.period), CELL.home.copy(), np.zeros(18)
    assert rule.finding(control(1, power=False, braked=True), q, v) == ""
    q[5] += 0.01
    assert "left_j3 travelled 0.0100 with all brakes on" in rule.finding(control(2, power=False, braked=True), q, v)


BEGUN, ENDED = [("begun", "g1", "/left/move"), ("begun", "g2", "/left/move")], [("ended", "g1", 4), ("ended", "g2", 6)]
PUTS = [("put", "spots", 1), ("put", "spots", 3), ("put", "spots", 2)]


@pytest.mark.parametrize(
    ("entries", "objects", "faults"),
    [
        ([*BEGUN, *ENDED, *PUTS], {"spots": 3, "other": 1}, []),
        ([*ENDED, *ENDED, *PUTS], {}, []),  # goals of before; and a command's objects go with it
        ([*BEGUN, BEGUN[0]], {}, ["goal g1 was begun 2 times"]),
        ([*BEGUN, *ENDED, ("ended", "g1", 6)], {}, ["goal g1 ended as 4, 6"]),
        (PUTS, {"spots": 2}, ["version 3 of spots was acknowledged, and the store has version 2"]),
    ],
)
def test_what_servers_told_is_judged_without_the_nets(entries, objects, faults):
    assert list(history.faults(entries, objects)) == faults


def test_a_history_whose_last_line_is_not_whole_is_read(tmp_path):
    file = tmp_path / "events.jsonl"
    file.write_text('["begun", "g1", "/left/move"]\n["ended", "g')
    assert list(history.read(file)) == BEGUN[:1]


@pytest.mark.parametrize("kind", over_hosts.KINDS)
def test_a_seed_repeats_a_fault_between_hosts(kind, tmp_path):
    machine = over_hosts.Machine(None, ("localhost", "a", "b"), tmp_path, tmp_path)
    drawn = [str(over_hosts.KINDS[kind](machine, Random(seed))) for seed in range(20)]
    assert [str(over_hosts.KINDS[kind](machine, Random(seed))) for seed in range(20)] == drawn
    assert not any("localhost" in each for each in drawn)


@pytest.mark.parametrize("given", [["--kinds", "cut"], ["--hosts", "2", "--kinds", "kill"]])
def test_kinds_of_faults_between_hosts_and_of_one_host_are_told_apart(given, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["chaos", *given])
    with pytest.raises(SystemExit):
        chaos.main()
    assert f"{given[-1]} is no fault" in capsys.readouterr().err
