"""Mirrors move at their rate, stop at their ends, and never come to rest at quite the same angle."""

import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from im_cell.link import HostEnd, LaserBeam, LaserEnd, Sensors
from im_cell.robot import load_cell
from im_sim.exposures import Exposures
from im_sim.laser import Laser
from im_sim.truth import draw_truth

SHEET = load_cell().laser
PERIOD_S = 0.001
STEP = SHEET.rate * PERIOD_S


def run(laser, command, ticks):
    seen = []
    for _ in range(ticks):
        laser.run_tick(command)
        seen.append(laser.beam)
    return seen


def test_mirrors_move_at_their_rate_and_stop_at_their_ends():
    laser = Laser(SHEET, PERIOD_S, seed=1)
    seen = run(laser, LaserBeam(0.2, -9.0, 0.1, 2.0), 10)
    first = np.diff([0.0, *(beam.mirror1 for beam in seen)])
    assert first.max() == pytest.approx(STEP)
    assert seen[-1].mirror1 == pytest.approx(0.2)
    assert min(beam.mirror2 for beam in seen) == -SHEET.range
    assert seen[-1].half_sweep == pytest.approx(SHEET.range - 0.2)
    assert {beam.power for beam in seen} == {1.0}


def test_where_mirrors_really_are_is_drawn_anew_for_each_command_from_the_seed():
    def errors(seed):
        laser, found = Laser(SHEET, PERIOD_S, seed), []
        for number in range(200):
            command = LaserBeam(0.01 * (number % 7), 0.02, 0.0, 1.0)
            laser.run_tick(command)
            before = laser.true
            laser.run_tick(command)
            assert laser.true.mirror1 - laser.beam.mirror1 == pytest.approx(
                before.mirror1 - before.mirror1 + error(laser)
            )
            found.append(error(laser))
        return np.array(found)

    def error(laser):
        return laser.true.mirror1 - laser.beam.mirror1

    np.testing.assert_array_equal(errors(3), errors(3))
    sample = errors(4)
    assert len(set(sample)) == 200
    assert 0.8 * SHEET.repeatability < sample.std() < 1.2 * SHEET.repeatability


def test_an_exposure_sees_the_mean_and_its_strobe():
    with HostEnd.create(f"imlaser{os.getpid()}", n_joints=2, period_s=PERIOD_S, factor=0.0) as host:
        exposures, q, beam = Exposures(host), np.zeros(2), LaserBeam(0.1, 0.2, 0.05, 0.5)
        view = host._shared.view
        for number, blank in enumerate((False, True), 1):
            view["exposure_ticks"][()], view["exposure_blank_laser"][()] = 2, blank
            view["exposure_request"][()] = number
            exposures.begin_tick(0)
            exposures.end_tick(1, q, q, SimpleNamespace(true=beam))
            exposures.end_tick(2, q, q, SimpleNamespace(true=replace(beam, mirror1=0.3)))
            assert int(view["exposure_done"]) == number
            np.testing.assert_allclose(view["exposure_laser"], [0.2, 0.2, 0.05, 0.0 if blank else 0.5])


def test_commands_and_readings_travel_over_the_link():
    instance, two = f"imlaser{os.getpid()}", np.zeros(2)
    with HostEnd.create(instance, n_joints=2, factor=0.0) as host:
        host.publish_state(0, Sensors(two, False, two > 0.0, two, two, np.zeros((2, 6)), two), two, two)
        with LaserEnd.attach(instance, 60.0) as laser:
            beam = LaserBeam(0.1, 0.2, 0.05, 0.5)
            laser.set_laser(beam)
            assert host.laser_command() == beam
            assert laser.laser() == LaserBeam()
            host.publish_laser(beam)
            assert laser.laser() == beam


def test_the_true_scanner_is_within_its_tolerances_and_another_for_each_seed():
    cell = load_cell()
    drawn = [draw_truth(cell, seed, perfect_arm=True).laser for seed in range(200)]
    gains = np.array([laser.gain for laser in drawn])
    assert 0.85 * SHEET.tolerance.gain < gains.std() < 1.15 * SHEET.tolerance.gain
    offsets = np.std([laser.offset for laser in drawn])
    assert 0.85 * SHEET.tolerance.offset < offsets < 1.15 * SHEET.tolerance.offset
    rotation, position = SHEET.pose()
    off = np.array([laser.position_m for laser in drawn]) - position
    assert 0.02 < np.abs(off).max() <= 0.03
    for laser in drawn:
        np.testing.assert_allclose(laser.model().rotation @ laser.model().rotation.T, np.eye(3), atol=1e-9)
        assert np.arccos((np.trace(laser.model().rotation @ rotation.T) - 1.0) / 2.0) < np.deg2rad(4.0)
