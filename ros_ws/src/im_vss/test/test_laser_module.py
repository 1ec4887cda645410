"""The scanner's Vision Module and the Tools that borrow it, with a scanner that only remembers."""

import os
from dataclasses import replace

import numpy as np
import pytest

from im_cell.frames import Frame, FrameSet, nobody
from im_cell.laser_model import LaserModel
from im_cell.link import HostEnd, LaserBeam, LaserEnd, Sensors
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import ConfigError, DataError, LimitError, StateError
from im_vss.camera_book import CameraBook
from im_vss.catalogue import load_catalogue
from im_vss.laser.book import LaserBook
from im_vss.laser.calibration import LaserCalibration
from im_vss.laser.scanner import LinkedScanner, check_beam
from im_vss.managers import VisionClient
from im_vss.rig import LaserRig, Rig
from im_vss.services.laser import LaserCalibrateRequest, LaserPointRequest, why_not
from im_vss.services.spot import CameraSpot
from im_vss.settings import load_settings
from im_vss.spot import SpotFinding, SpotFit
from im_vss.tools.spot import StereoFinding
from im_vss.vsm import VisionServicesManager

CELL = load_cell()
POWER = load_settings(CELL).laser.spot_power


class Scanner:
    """Is at once where it shall be, and remembers where it was."""

    def __init__(self):
        self.driven, self.darkened = [], 0

    def darken(self):
        self.darkened += 1

    def drive(self, beam, timeout_s):
        self.driven.append(beam)
        return 1000 + len(self.driven)

    def reading(self):
        return self.driven[-1] if self.driven else LaserBeam()

    def close(self):
        self.driven.append(LaserBeam())


class Cameras:
    """Black images; `meanwhile` runs while the shutter is open."""

    def __init__(self, scanner):
        self.scanner, self.orders, self.seen, self.meanwhile = scanner, [], [], lambda: None

    def take_frames(self, order, exposed=nobody):
        self.orders.append(order)
        self.seen.append(self.scanner.reading())
        self.meanwhile()
        black = np.zeros((480, 640), np.uint8)
        frames = {
            camera: tuple(Frame(camera, black, number, blank) for number, blank in enumerate(order.blank_light))
            for camera in order.cameras
        }
        return FrameSet(frames, {}, order.exposure_s)


class Screen:
    """Shows nothing."""

    def raw(self, frame):
        """Not looked at."""

    def display(self, camera, image, stamp_ns):
        """Not looked at."""


@pytest.fixture
def system(tmp_path):
    def build(*services, laser=True):
        settings = load_settings(CELL).model_copy(update={"services": services})
        scanner = Scanner()
        cameras, book = Cameras(scanner), LaserBook(CELL.laser, tmp_path)
        rig = Rig(
            settings, CELL, CameraBook(CELL, settings.cameras, tmp_path), cameras, Screen(),
            laser=LaserRig(scanner, book) if laser else None,
        )  # fmt: skip
        systems.append(VisionServicesManager(rig, load_catalogue()))
        return systems[-1], scanner, cameras

    systems = []
    yield build
    for made in systems:
        made.close()


def test_only_what_pointing_needs_is_loaded(system):
    vsm, _, _ = system("laser_point")
    assert (list(vsm.tools), list(vsm.modules), list(vsm.managers)) == (
        ["tool_laser_point"], ["vm_laser"], ["laser_scanner"],
    )  # fmt: skip
    both, _, _ = system("laser_spot_3d")
    assert set(both.managers) == {"image_processing", "laser_scanner"}
    assert "vm_laser" not in system("snap", "spot_find")[0].modules


def test_who_takes_over_the_scanner_makes_it_dark(system):
    assert system("laser_point")[1].darkened == 1
    assert system("snap")[1].darkened == 0  # it is another process's


def test_a_beam_that_a_dead_process_left_is_switched_off():
    instance, two = f"imdark{os.getpid()}", np.zeros(2)
    scanner = LinkedScanner(instance, CELL.laser)
    began = clock.monotonic()
    scanner.darken()
    assert clock.monotonic() - began < 0.5  # without a testbed nothing is waited for
    with HostEnd.create(instance, n_joints=2, factor=0.0) as host:
        scanner.darken()  # of a testbed that is not there yet, neither
        host.publish_state(0, Sensors(two, False, two > 0.0, two, two, np.zeros((2, 6)), two), two, two)
        with LaserEnd.attach(instance, 60.0) as dead:
            dead.set_laser(LaserBeam(0.1, 0.2, 0.0, 1.0))
        scanner.darken()
        assert host.laser_command() == LaserBeam()
        scanner.close()


def test_pointing_at_a_target_is_the_inverse_of_the_drawn_scanner(system):
    vsm, scanner, _ = system("laser_point")
    target = np.array([0.2, 0.9, 0.75])
    result = vsm.request("laser_point", LaserPointRequest((0.0, 0.0), target, on=True))
    start, way = LaserModel(*CELL.laser.pose(), CELL.laser.gap).rays([result.beam.mirror1, result.beam.mirror2])
    assert np.linalg.norm(np.cross(target - start, way)) < 1e-12
    assert (scanner.driven[-1].power, result.stamp_ns, result.calibrated) == (POWER, 1001, False)
    vsm.request("laser_point", LaserPointRequest((0.01, 0.02), None, on=False))
    assert scanner.driven[-1] == LaserBeam(0.01, 0.02, 0.0, 0.0)


def test_a_pair_of_frames_is_taken_in_the_beam_and_it_is_dark_afterwards(system):
    vsm, scanner, cameras = system("laser_spot_3d")
    beam = LaserBeam(0.05, -0.02, 0.0, POWER)
    _, reading = vsm.tools["tool_laser_snap"](VisionClient("me"), ("wall",), beam, 0.0)
    assert (reading, cameras.seen) == (beam, [beam])
    assert (cameras.orders[0].blank_light, cameras.orders[0].blank_laser) == ((True, True), (True, False))
    assert scanner.driven == [beam, LaserBeam(0.05, -0.02, 0.0, 0.0)]
    vsm.tools["tool_laser_snap"](VisionClient("me"), ("wall",), None, 0.0)
    assert len(scanner.driven) == 2  # as it is, it stays


def test_the_beam_of_a_client_that_gave_up_is_dark(system):
    vsm, scanner, cameras = system("laser_spot_3d")
    client = VisionClient("me")
    cameras.meanwhile = client.cancel
    with pytest.raises(StateError, match="me was cancelled"):
        vsm.tools["tool_laser_snap"](client, ("wall",), LaserBeam(0.05, 0.0, 0.0, POWER), 0.0)
    assert scanner.driven[-1].power == 0.0
    state = vsm.state().modules["vm_laser"][1]
    assert (state.owner, state.leases, state.lapsed) == ("", 1, 1)


@pytest.mark.parametrize("when", ["while the cameras are busy", "while they expose"])
def test_what_was_exposed_after_the_lease_of_the_laser_is_no_answer(system, monkeypatch, when):
    """Its beam may be that of another client by then."""
    vsm, _, cameras = system("laser_spot_3d")
    leases = []
    acquire = vsm.managers["laser_scanner"]._acquire

    def remembered(module, client):
        leases.append(acquire(module, client))
        return leases[-1]

    def lapse(*_):
        leases[-1].deadline = -1.0

    monkeypatch.setattr(vsm.managers["laser_scanner"], "_acquire", remembered)
    if when == "while they expose":
        cameras.meanwhile = lapse
    else:
        drive = vsm.modules["vm_laser"].drive
        monkeypatch.setattr(vsm.modules["vm_laser"], "drive", lambda *given: (drive(*given), lapse())[0])
    with pytest.raises(StateError, match="the lease of vm_laser by me is over"):
        vsm.tools["tool_laser_snap"](VisionClient("me"), ("wall",), LaserBeam(0.05, 0.0, 0.0, POWER), 0.0)
    assert len(cameras.orders) == (when == "while they expose")


def test_the_beam_of_the_next_client_is_left_alone(system):
    vsm, scanner, _ = system("laser_point")
    module, vmm = vsm.modules["vm_laser"], vsm.managers["laser_scanner"]
    first, second = LaserBeam(0.05, 0.0, 0.0, POWER), LaserBeam(0.06, 0.0, 0.0, POWER)
    for name, beam in (("one", first), ("two", second)):
        with vmm.lend("vm_laser", VisionClient(name)) as lease:
            module.drive(lease, beam)
    module.darken(first)
    assert scanner.reading() == second
    with pytest.raises(StateError, match="the lease of vm_laser by two is over"):
        module.drive(lease, first)


def test_a_cell_without_a_scanner_says_so(system):
    vsm, _, _ = system("laser_point", laser=False)
    with pytest.raises(StateError, match="there is no laser scanner"):
        vsm.request("laser_point", LaserPointRequest((0.0, 0.0), None, on=True))


def test_a_cancelled_calibration_does_not_change_the_scanner(system, monkeypatch):
    vsm, _, _ = system("laser_calibrate")
    rig = vsm.services["laser_calibrate"].rig
    monkeypatch.setattr("im_vss.services.laser.fixed_cameras", lambda rig, cameras, count: cameras)

    def calibrate(*_):
        vsm.cancel("laser_calibrate #1")
        return LaserCalibration(rig.scanner.book.entry.model, np.eye(10), (), 0.0, 1.0, np.empty(0, bool), np.empty(0))

    monkeypatch.setattr("im_vss.tools.laser.calibrate", calibrate)
    request = LaserCalibrateRequest(("ceiling_left", "ceiling_right"), (0.0,), (0.0,), apply=True)
    with pytest.raises(StateError, match="laser_calibrate #1 was cancelled"):
        vsm.request("laser_calibrate", request)
    assert not rig.scanner.book.entry.calibrated


def test_a_calibration_of_more_spots_than_it_may_have_is_refused_before_a_mirror_moves(system, monkeypatch):
    vsm, scanner, _ = system("laser_calibrate")
    monkeypatch.setattr("im_vss.services.laser.fixed_cameras", lambda rig, cameras, count: cameras)
    request = LaserCalibrateRequest(("ceiling_left", "ceiling_right"), (0.0,) * 1601, (0.0,) * 1601)
    with pytest.raises(ConfigError, match="1601 spots are more than 1600"):
        vsm.request("laser_calibrate", request)
    assert scanner.driven == []


@pytest.mark.parametrize(
    ("place", "sentence"),
    [
        ([0.05, 1.47, 0.75], "out of sight of table: it would be behind it"),
        ([0.05, 1.2, 0.75], "out of sight of table: it would be at ("),
        ([0.0, 0.2, 1.0], "table: hidden, or too dark: it would be at ("),
    ],
)
def test_one_camera_and_the_beam_say_where_the_other_would_see_the_spot(system, place, sentence):
    vsm, _, _ = system("laser_spot_3d")
    rig = vsm.services["laser_spot_3d"].rig
    model = rig.book["ceiling_left"].model
    u, v = model.project(place)
    fit = SpotFit(u, v, np.eye(2) * 1e-3, 100.0, 1.0, 50.0, 1.0, 0, True)
    spots = (
        CameraSpot("ceiling_left", 0, SpotFinding(fit, "", 50.0, (fit,))),
        CameraSpot("table", 0, SpotFinding(None, "no light seen", 0.0)),
    )
    none = StereoFinding(None, "table: no light seen", float("nan"), (fit, None))
    first, second = rig.scanner.book.entry.model.angles_to(place)
    told = why_not(rig, spots, none, LaserBeam(first, second, 0.0, POWER))
    assert told.startswith(sentence)
    if "(" in sentence:
        wanted = rig.book["table"].model.project(place)
        assert f"({wanted[0]:.0f}, {wanted[1]:.0f}) px" in told
    assert why_not(rig, spots, none, LaserBeam(first, second)) == "the laser is not lit"


def test_a_spot_where_the_lens_cannot_be_inverted_has_that_as_its_cause(system):
    vsm, _, _ = system("laser_spot_3d")
    rig, names = vsm.services["laser_spot_3d"].rig, ("ceiling_left", "ceiling_right")
    model = rig.book["ceiling_left"].model
    folded = {"ceiling_left": replace(model, D=np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))}
    rig.book.set_cameras({**{name: rig.book[name].model for name in names}, **folded})
    fit = SpotFit(20.0, 20.0, np.eye(2) * 1e-3, 100.0, 1.0, 50.0, 1.0, 0, True)
    seen, unseen = SpotFinding(fit, "", 50.0, (fit,)), SpotFinding(None, "no light seen", 0.0)
    with pytest.raises(DataError) as fault:
        rig.book["ceiling_left"].model.ray([20.0, 20.0])
    assert vsm.tools["tool_triangulate"](names, (seen, seen)).cause == fault.value.message
    spots = CameraSpot(names[0], 0, seen), CameraSpot(names[1], 0, unseen)
    none = StereoFinding(None, "ceiling_right: no light seen", float("nan"), (fit, None))
    told = why_not(rig, spots, none, LaserBeam(0.0, 0.0, 0.0, POWER))
    assert told == f"ceiling_right: no light seen; ceiling_left: {fault.value.message}"


@pytest.mark.parametrize(
    ("beam", "kind", "sentence"),
    [
        (LaserBeam(-0.23), LimitError, "mirror1 of the laser scanner: position -0.23 rad is beyond the limit 0.22 rad"),
        (LaserBeam(0.2, 0.0, 0.05), LimitError, "mirror1 of the laser scanner: position 0.25 rad is beyond"),
        (LaserBeam(0.0, float("inf")), LimitError, "mirror2 of the laser scanner: position inf rad"),
        (LaserBeam(0.0, 0.0, 0.0, 1.5), StateError, "the power of the laser 1.5 is not between 0 and 1"),
    ],
)
def test_beams_that_cannot_be_shown(beam, kind, sentence):
    with pytest.raises(kind, match=sentence):
        check_beam(beam, CELL.laser)
