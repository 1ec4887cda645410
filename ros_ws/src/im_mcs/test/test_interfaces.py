"""Slots that take velocities or positions: laws that fit, no leap, and what each kind does when it is stopped."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from im_core.errors import ConfigError
from im_mcs.client.controllers import listed_controllers
from im_mcs.limits.configuration import load_config
from support.mcs_config import mcs_text

LEFT = slice(0, 9)
LAWS = {
    "position": {"controller": "im_mcs.control.setpoints:SetpointPosition"},
    "velocity": {
        "controller": "im_mcs.control.setpoints:SetpointVelocity",
        "parameters": {"gain_1_s": 10.0, "rest_deadband": 1e-4},
    },
}
DRIVER = {"driver": "im_mcs.testbed.loopback:LoopbackDriver", "settings": {"inertia": [1.0], "q": [0.0]}}


def file_of(tmp_path, change):
    """A file of slots, all on the loopback driver, with a change."""
    data = yaml.safe_load(mcs_text())
    data["testbed"]["drivers"]["testbed"] = DRIVER
    change(data)
    path = tmp_path / "mcs.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    return path


def all_of(kind):
    """Let every joint take commands of a kind, by a law that gives them."""

    def change(data):
        for slot in data["slots"]:
            if slot.get("kind", "joint") == "joint":
                slot["interface"] = kind
        data["control"] = LAWS[kind]

    return change


@pytest.fixture
def bench_of(tmp_path, make_bench):
    return lambda kind: make_bench(load_config(file_of(tmp_path, all_of(kind))))


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_a_move_arrives_without_a_leap(bench_of, cell, kind):
    bench = bench_of(kind)
    bench.to_motion("left")
    mcs, limits = bench.mcs, bench.mcs.limits
    target = cell.home[LEFT] + 0.2
    places, commands = [bench.driver.q.copy()], []

    def look():
        places.append(bench.driver.q.copy())
        commands.append(bench.driver.drive.command.copy())

    reply = bench.ask("move", look, group="left", path={"kind": "joint", "points": [target.tolist()], "blend": 0.0})
    assert reply["success"], reply
    np.testing.assert_allclose(bench.driver.q[LEFT], target, atol=1e-4)
    bound = limits.ceiling.velocity * mcs.config.servo.period_s * 1.1
    assert (np.abs(np.diff(places, axis=0)) <= bound + 1e-9).all()
    if kind == "position":
        assert (np.abs(np.diff(commands, axis=0)) <= bound + 1e-9).all()
        np.testing.assert_array_equal(np.array(commands)[:, 9:], np.tile(cell.home[9:], (len(commands), 1)))
    else:
        assert (np.array(commands)[:, 9:] == 0.0).all()
        assert not commands[-1].any(), "noise within the dead band moves no arm at rest"
    assert not mcs.tau.any()


@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_the_first_position_is_where_the_arm_was_put(bench_of, cell, kind):
    bench = bench_of(kind)
    bench.mcs.tick([])
    bench.driver.q = cell.home + 0.1  # by hand, while it is cold
    for _ in range(100):
        bench.mcs.tick([])
    bench.to_motion("left")
    for _ in range(20):
        bench.mcs.tick([])
    np.testing.assert_allclose(bench.driver.q, cell.home + 0.1, atol=1e-6)


@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("stop", ["estop", "protective_stop", "pause"])
def test_a_stop_on_the_way_holds_where_the_arm_is(bench_of, cell, kind, stop):
    bench = bench_of(kind)
    bench.to_motion("left")
    target = cell.home[LEFT] + 0.5
    bench.send("move", group="left", path={"kind": "joint", "points": [target.tolist()], "blend": 0.0})
    for _ in range(100):
        bench.mcs.tick([])
    assert np.abs(bench.driver.v[LEFT]).max() > 0.01
    before = bench.driver.q.copy()
    bench.send(stop, **({} if stop == "pause" else {"reason": "somebody comes"}))
    if stop == "estop":
        drive = bench.driver.drive
        assert not drive.power
        np.testing.assert_allclose(drive.command, before if kind == "position" else np.zeros(18), atol=1e-12)
    for _ in range(600):
        bench.mcs.tick([])
    stood = bench.driver.q.copy()
    if stop == "estop":
        assert np.abs(stood - before)[LEFT].max() < 0.01
    else:
        assert (stood[LEFT] < target - 0.01).all()  # it braked on its way
    for _ in range(50):
        bench.mcs.tick([])
    np.testing.assert_allclose(bench.driver.q, stood, atol=1e-9)


def test_a_joint_that_does_not_follow_is_a_following_error(bench_of, cell):
    for kind in ("position", "velocity"):
        bench = bench_of(kind)
        bench.to_motion("left")
        target = cell.home[LEFT] + 0.3
        bench.send("move", group="left", path={"kind": "joint", "points": [target.tolist()], "blend": 0.0})
        said = ""
        for _ in range(500):
            bench.driver.q = cell.home.copy()  # something holds it
            bench.mcs.tick([])
            protective = bench.mcs.groups["left"].protective
            said = said or ("" if protective is None else protective.message)
        assert "following error" in said


def test_torques_of_a_client_are_refused(bench_of):
    bench = bench_of("position")
    bench.to_motion("left")
    reply = bench.reply(bench.send("stream", group="left", kind="torque", torques=[0.0] * 9, lease_s=0.1))
    assert reply is not None
    assert "group 'left' takes position, no torques" in str(reply)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda data: data["slots"][3].update(interface="position"),
            r"mcs.yaml:\d+: control.controller: control law 'im_mcs.control.pid_gravity:PidGravity' gives effort, and "
            r"slot 'left_j1' of group 'left' takes position; its law needs a method 'position'",
        ),
        (
            lambda data: data.update(control=LAWS["velocity"]),
            r"SetpointVelocity' gives velocity, and slot 'left_track' of group 'left' takes effort",
        ),
        (
            lambda data: (
                all_of("position")(data),
                data["testbed"]["drivers"].update(
                    testbed={"driver": "im_mcs.testbed.simulated:SimulatedDriver"},
                ),
            ),
            r"mcs.yaml:\d+: slots\[0\].interface: slot 'left_track': driver 'testbed' takes effort, not position",
        ),
        (
            lambda data: (
                all_of("position")(data),
                data.update(law_processes={"laws": [LAWS["position"]["controller"]]}),
            ),
            r"SetpointPosition' gives position; only a law of torques may have a process of its own",
        ),
        (
            lambda data: data["slots"][-1].update(interface="velocity"),
            r"slot 'right_force' is a wrench; only joints have an interface",
        ),
        (lambda data: data["slots"][0].update(interface="torque"), r"slots\[0\].interface"),
    ],
)
def test_combinations_that_do_not_fit_are_refused_by_name_and_line(tmp_path, change, message):
    with pytest.raises(ConfigError, match=message):
        load_config(file_of(tmp_path, change))


def test_laws_of_another_kind_are_no_laws_of_the_group(tmp_path):
    config = load_config(file_of(tmp_path, all_of("velocity")))
    assert list(config.parameters_of_laws("left")) == [LAWS["velocity"]["controller"]]


def test_controllers_write_what_the_slots_take(tmp_path):
    config = load_config(file_of(tmp_path, all_of("velocity")))
    law = next(each for each in listed_controllers(config, {}, {}) if each.name == "left_SetpointVelocity")
    assert law.commands == tuple(f"{joint}/velocity" for joint in config.groups["left"].joints)


class Runaway:
    """A position law that wants the joints ever further out."""

    def __init__(self, setup):
        self.far = 0.0

    def reset(self):
        self.far = 0.0

    def hold_integral(self, hold):
        pass

    def position(self, given):
        self.far += 1.0
        return given.q + self.far


def test_no_law_of_positions_makes_a_joint_leap_or_leave_its_range(tmp_path, make_bench, monkeypatch):
    monkeypatch.syspath_prepend(Path(__file__).parent)
    change = all_of("position")

    def wild(data):
        change(data)
        data["control"] = {"controller": "test_interfaces:Runaway"}
        data["limits"].update(following_error_rad=99.0, following_error_m=99.0)

    bench = make_bench(load_config(file_of(tmp_path, wild)))
    bench.to_motion("left")
    limits, commands = bench.mcs.limits, []
    for _ in range(1000):
        bench.mcs.tick([])
        commands.append(bench.driver.drive.command.copy())
    bound = limits.ceiling.velocity * bench.mcs.config.servo.period_s * 1.1
    assert (np.abs(np.diff(commands, axis=0)) <= bound + 1e-9).all()
    assert (np.array(commands)[:, LEFT] <= limits.upper[LEFT] + 1e-9).all()
    assert bench.mcs.saturations.counts[:, LEFT].sum() > 100


def test_groups_of_both_kinds_move_at_once_and_stop_each_in_its_way(tmp_path, make_bench, frictionless, cell):
    def change(data):
        for slot in data["slots"][9:18]:
            slot["interface"] = "position"
        data["presets"] = {"2x9": data["presets"]["2x9"]}
        data["control"]["parameters"] = frictionless.control.parameters
        data["group_control"] = {"right": LAWS["position"]}

    bench = make_bench(load_config(file_of(tmp_path, change)))
    bench.to_motion("left", "right")
    for group, side, far in (("left", LEFT, 0.2), ("right", slice(9, 18), -0.2)):
        target = (cell.home[side] + far).tolist()
        bench.send("move", group=group, path={"kind": "joint", "points": [target], "blend": 0.0})
    for _ in range(150):
        bench.mcs.tick([])
    assert (np.abs(bench.driver.v) > 0.01).all(), str(bench.reply(6))
    assert bench.mcs.tau[LEFT].any()
    assert not bench.mcs.tau[9:].any()
    here = bench.driver.q.copy()
    bench.send("estop", reason="red button")
    np.testing.assert_array_equal(bench.driver.drive.command[LEFT], np.zeros(9))
    np.testing.assert_array_equal(bench.driver.drive.command[9:], here[9:])


def test_a_reading_that_has_leapt_is_no_place_to_stand(bench_of, cell):
    """A robot that keeps its last command would go there."""
    bench = bench_of("position")
    bench.to_motion("left")
    read, off = bench.driver.read, np.zeros(18)

    def leapt():
        measured = read()
        return measured._replace(q=measured.q + off)

    bench.driver.read = leapt
    off[4] = 0.5
    for _ in range(5):
        bench.mcs.tick([])
        np.testing.assert_allclose(bench.driver.drive.command[LEFT], cell.home[LEFT], atol=1e-6)
    assert not bench.driver.drive.power
    off[4] = 0.0
    bench.driver.q[4] += 0.03  # by hand
    for _ in range(50):
        bench.mcs.tick([])
    assert bench.driver.drive.command[4] == pytest.approx(cell.home[4] + 0.03, abs=1e-6)
    off[4] = 30.0
    assert "there is a reading of left_j2, " in str(bench.ask("reset"))
    off[4] = 0.0
    assert bench.ask("reset")["success"]


def test_a_joint_without_a_reading_keeps_its_position(bench_of, cell):
    bench = bench_of("position")
    bench.to_motion("left")
    read = bench.driver.read

    def blind():
        measured = read()
        measured.q[4] = np.nan
        return measured

    bench.driver.read = blind
    for _ in range(3):
        bench.mcs.tick([])
        np.testing.assert_allclose(bench.driver.drive.command, cell.home, atol=1e-6)
    assert not bench.driver.drive.power
    assert "gave no reading" in bench.mcs.manager.cause
