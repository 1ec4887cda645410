"""What is broken shows in the sensors, in this process and through the link."""

import os
from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from im_cell.link import Drive, Faults, HostEnd, JawObject, PanelEnd, ServoEnd, StopEnd
from im_cell.robot import load_cell
from im_core.errors import DataError, NotFoundError
from im_core.shm_names import remove_all
from im_sim.laser import Laser
from im_sim.loop import TickLoop
from im_sim.panel import FaultPanel
from im_sim.plant import Plant

CELL = load_cell()
N = len(CELL.joints)
SOUND = Faults.none(N)
FREE = np.zeros(N, dtype=bool)
INSTANCE = f"imfaults{os.getpid()}"


def only(joint):
    return np.arange(N) == joint


@pytest.fixture
def plant():
    plant = Plant(CELL, seed=1)
    yield plant
    plant.close()


def run(plant, ticks, first=0):
    """Free joints without torque: the arms fall. Sensors by tick."""
    seen = []
    for tick in range(first, first + ticks):
        seen.append(plant.sensors(tick))
        plant.run_tick(Drive(np.zeros(N), True, FREE, np.zeros(2), True, np.full(2, np.inf)))
    return seen


def test_a_blind_encoder_gives_no_number_until_it_is_mended(plant):
    run(plant, 1)
    plant.break_(replace(SOUND, encoder_nan=only(4)))
    assert np.flatnonzero(np.isnan(plant.sensors(1).q)).tolist() == [4]
    plant.break_(SOUND)
    assert np.isfinite(plant.sensors(2).q).all()


def test_a_frozen_encoder_stays_and_grows_old(plant):
    run(plant, 30)
    plant.break_(replace(SOUND, encoder_frozen=only(5)))
    at = plant.q[5]
    frozen = run(plant, 40, first=30)
    assert len({s.q[5] for s in frozen}) == 1
    assert frozen[0].q[5] == pytest.approx(at, abs=1e-4)
    assert abs(at - plant.q[5]) > 0.001, "the joint has fallen on"
    assert [s.age_s[5] for s in frozen] == pytest.approx([k * CELL.period for k in range(40)])
    assert not np.delete(frozen[-1].age_s, 5).any()
    plant.break_(SOUND)
    assert abs(plant.sensors(70).q[5] - plant.q[5]) < 1e-4
    assert plant.sensors(70).age_s[5] == 0.0


def test_without_power_every_brake_holds_whatever_is_commanded(plant):
    plant.break_(replace(SOUND, power_loss=True))
    before = plant.q
    last = run(plant, 20)[-1]
    assert not last.power
    assert last.brakes.all()
    assert np.abs(plant.q - before).max() < 1e-9


def test_a_stuck_brake_holds_its_joint_and_says_so(plant):
    plant.break_(replace(SOUND, brake_stuck=only(4)))
    before = plant.q
    last = run(plant, 30)[-1]
    assert last.brakes.tolist() == only(4).tolist()
    assert last.power
    assert abs(plant.q[4] - before[4]) < 1e-6
    assert np.abs(plant.q - before)[5] > 1e-3


@pytest.mark.parametrize("power", [True, False])
def test_an_open_brake_lets_its_joint_fall_and_says_so(plant, power):
    plant.break_(replace(SOUND, brake_open=only(5)))
    before = plant.q
    for tick in range(30):
        seen = plant.sensors(tick)
        plant.run_tick(Drive(np.zeros(N), power, ~FREE, np.zeros(2), True, np.full(2, np.inf)))
    assert np.flatnonzero(~seen.brakes).tolist() == [5]
    assert abs(plant.q - before)[5] > 1e-3
    assert np.delete(np.abs(plant.q - before), 5).max() < 1e-6
    plant.run_tick(None)
    assert np.flatnonzero(~plant.brakes).tolist() == [5], "nor does it hold when nobody commands"
    plant.break_(SOUND)
    plant.run_tick(None)
    assert plant.brakes.all()


def test_faults_and_objects_travel_over_the_link(plant):
    with HostEnd.create(INSTANCE, factor=0.0) as host:
        loop = TickLoop(plant, Laser(CELL.laser, CELL.period, seed=1), host)
        client, end = ServoEnd.attach(INSTANCE, 60.0), PanelEnd.attach(INSTANCE, 60.0)
        panel = FaultPanel(CELL, end)
        assert panel.inject("encoder_nan", "left_j3", True, 0.0) == "broken: encoder_nan of left_j3"
        panel.inject("brake_stuck", "right_j1", True, 0.0)
        said = panel.inject("brake_open", "right_j2", True, 0.0)
        assert said == "broken: encoder_nan of left_j3, brake_stuck of right_j1, brake_open of right_j2"
        assert panel.put_in_jaws("right_gripper", 0.09, 1e4, 0.5) == "90 mm wide, 0.5 kg, in right_gripper"
        loop.run_tick()
        state = client.read_state()
        assert np.isnan(state.q[CELL.joint_names.index("left_j3")])
        assert np.isnan(state.q).sum() == 1
        assert np.flatnonzero(~state.brakes).tolist() == [CELL.joint_names.index("right_j2")]
        assert (
            panel.inject("encoder_nan", "left_j3", False, 0.0)
            == "broken: brake_stuck of right_j1, brake_open of right_j2"
        )
        assert panel.put_in_jaws("right_gripper", 0.0, 0.0, 0.0) == "nothing is in right_gripper"
        loop.run_tick()
        assert np.isfinite(client.read_state().q).all()

        assert panel.inject("stall", "", True, 0.3) == "physics stalls for 0.3 s"
        assert host.take_stall() == 0.3
        assert host.take_stall() == 0.0
        client.close()
        end.close()
    assert remove_all(INSTANCE) == []


def test_the_stop_circuit_takes_the_power_whatever_the_servo_wants(plant):
    with HostEnd.create(INSTANCE, factor=0.0) as host:
        loop = TickLoop(plant, Laser(CELL.laser, CELL.period, seed=1), host)
        servo, stop = ServoEnd.attach(INSTANCE, 60.0), StopEnd.attach(INSTANCE, 60.0)
        servo.attach_servo(os.getpid())
        insisting = Thread(target=lambda: [servo.wait_state(60.0) and insist(servo) for _ in range(4)])
        insisting.start()
        loop.run_tick()
        assert servo.read_state().power
        assert not stop.is_cut
        stop.cut()
        assert host.demand()
        with StopEnd.attach(INSTANCE, 60.0) as later:
            assert later.is_cut
        loop.run_tick()
        assert not servo.read_state().power
        assert servo.read_state().brakes.all()
        loop.run_tick()
        assert not servo.read_state().power, "it stays cut"
        stop.restore()
        loop.run_tick()
        assert servo.read_state().power
        insisting.join()
        servo.close()
        stop.close()
    assert remove_all(INSTANCE) == []


def insist(servo):
    """A servo that wants power and free joints, always."""
    servo.write_command(Drive(np.zeros(N), True, FREE, np.zeros(2), True, np.full(2, np.inf)))


def test_faults_that_cannot_be_are_refused_and_change_nothing(plant):
    with HostEnd.create(INSTANCE, factor=0.0) as host:
        TickLoop(plant, Laser(CELL.laser, CELL.period, seed=1), host)
        end = PanelEnd.attach(INSTANCE, 60.0)
        panel = FaultPanel(CELL, end)
        with pytest.raises(NotFoundError, match=r"there is no fault 'encoder_nann'; did you mean 'encoder_nan'"):
            panel.inject("encoder_nann", "left_j3", True, 0.0)
        with pytest.raises(NotFoundError, match="there is no joint 'left_j7'"):
            panel.inject("brake_stuck", "left_j7", True, 0.0)
        with pytest.raises(DataError, match="power_loss is a fault of the whole testbed, not of 'left_j1'"):
            panel.inject("power_loss", "left_j1", True, 0.0)
        with pytest.raises(DataError, match=r"a stall of -1\.0 s"):
            panel.inject("stall", "", True, -1.0)
        with pytest.raises(NotFoundError, match="there is no gripper 'gripper'"):
            panel.put_in_jaws("gripper", 0.1, 1.0, 1.0)
        with pytest.raises(DataError, match="cannot be"):
            panel.put_in_jaws("left_gripper", 0.1, -1.0, 1.0)
        with pytest.raises(DataError, match="at most 1 m, 1e\\+09 N/m and 1000 kg"):
            panel.put_in_jaws("left_gripper", 0.1, 1e4, 1e308)
        assert host.disturbances() is None
        end.close()


def test_what_is_being_written_is_taken_when_it_is_whole(plant):
    with HostEnd.create(INSTANCE, factor=0.0) as host:
        TickLoop(plant, Laser(CELL.laser, CELL.period, seed=1), host)
        cube = JawObject(0.05, 1e4, 0.1)
        with PanelEnd.attach(INSTANCE, 60.0) as panel:
            panel.set_object(0, cube)
            with panel._changing():
                assert host.disturbances() is None
            assert host.disturbances()[1] == (cube, None)
            assert host.disturbances() is None
            panel._changing().__enter__()  # the node dies there
        assert host.disturbances() is None
        with PanelEnd.attach(INSTANCE, 60.0) as panel:
            panel.set_object(1, cube)
            assert host.disturbances()[1] == (cube, cube)
