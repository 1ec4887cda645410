"""Looks: what is found in images that were exposed before, while the arms go on."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from im_cell.frames import Frame, FrameSet
from im_cell.robot import load_cell
from im_core.errors import DataError, LinkError, NotFoundError, StateError, WaitTimeoutError
from im_vss.camera_book import CameraBook
from im_vss.camera_poses import Mounts
from im_vss.catalogue import load_catalogue
from im_vss.pending_looks import FORGOTTEN, MOST_LOOKS, Look, Looks
from im_vss.rig import Rig
from im_vss.services.spot import SpotFindRequest
from im_vss.settings import load_settings
from im_vss.vsm import VisionServicesManager

CELL = load_cell()
CAMERA = "ceiling_left"
LIGHT = np.array([0.1, 0.2, 1.0])


class Cameras:
    """Expose at once, and have no image before they are let; the arm goes on as soon as it is exposed.

    Attributes:
        tick_s: What their exposures are multiples of; 0: they are as ordered [s].
    """

    def __init__(self):
        self.go, self.failure, self.shut, self.at, self.tick_s = threading.Event(), None, 0, LIGHT, 0.0

    def take_frames(self, order, exposed):
        self.shut += 1
        stamps = tuple(1000 * self.shut + number for number in range(len(order.blank_light)))
        exposed(stamps)
        self.at = LIGHT + 1.0
        assert self.go.wait(60.0)
        if self.failure is not None:
            raise self.failure
        black = np.full((480, 640), 40, np.uint8)
        frames = tuple(Frame(CAMERA, black, *told) for told in zip(stamps, order.blank_light, strict=True))
        exposure_s = round(order.exposure_s / self.tick_s) * self.tick_s if self.tick_s else order.exposure_s
        return FrameSet({CAMERA: frames}, {}, exposure_s)


class Screen:
    def raw(self, frame):
        pass

    def display(self, camera, image, stamp_ns):
        pass

    def spot(self, camera, place, stamp_ns):
        pass


def patient():
    """Nothing ends the wait."""


@pytest.fixture
def cameras():
    return Cameras()


@pytest.fixture
def vsm(cameras, tmp_path):
    settings = load_settings(CELL)
    book = CameraBook(CELL, settings.cameras, tmp_path)
    rig = Rig(settings, CELL, book, cameras, Screen(), light_position=lambda _: cameras.at)
    vsm = VisionServicesManager(rig, load_catalogue())
    yield vsm
    cameras.go.set()
    vsm.close()


def test_a_look_is_answered_when_all_is_exposed_and_its_result_is_there_later_as_often_as_asked(vsm, cameras):
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,)))
    assert not cameras.go.is_set()
    cameras.go.set()
    found = [vsm.request("spot_find", SpotFindRequest((CAMERA,), look=name)) for _ in range(2)]
    assert found[0] is found[1]
    assert [(spot.camera, spot.stamp_ns) for spot in found[0].spots] == [(CAMERA, 1001)]
    assert cameras.shut == 1


def test_the_light_is_searched_where_it_was_when_it_was_exposed(vsm, cameras):
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,)))
    cameras.go.set()
    (spot,) = vsm.request("spot_find", SpotFindRequest((CAMERA,), look=name)).spots
    disc = spot.finding.region
    assert (disc.u, disc.v) == pytest.approx(tuple(vsm.services["spot_find"].rig.book[CAMERA].model.project(LIGHT)))


def test_of_a_camera_on_an_arm_it_is_told_where_the_light_should_be(vsm, cameras):
    rig, wrist = vsm.services["spot_find"].rig, CELL.cameras["wrist_left"].parent
    turn, origin = Rotation.from_euler("xyz", (0.3, -0.2, 1.0)).as_matrix(), np.array([0.5, 0.1, 1.2])
    entry = rig.book["wrist_left"]
    in_wrist = entry.model.position + 0.8 * entry.model.ray([250.0, 300.0])
    cameras.at = origin + turn @ in_wrist
    black = [Frame("wrist_left", np.full((480, 640), 40, np.uint8), stamp, stamp == 6) for stamp in (6, 7)]
    find = vsm.services["spot_find"].tool("tool_spot_find")
    assert find(*black).region is None, "where the arm was is not known"
    rig = replace(rig, mounts=Mounts(lambda frame, stamp_ns: (turn, origin) if frame == wrist else None))
    rig.mounts.note(wrist, [7])
    found = type(find)(rig, find.modules)(*black)
    assert (found.region.u, found.region.v) == pytest.approx((250.0, 300.0), abs=1e-3)
    assert "searched within" not in found.cause, "and it is searched everywhere"


@pytest.mark.parametrize(
    ("failure", "told"), [(LinkError("the cameras are gone"), LinkError), (SystemExit("are gone"), RuntimeError)]
)
def test_what_fails_after_the_exposure_is_told_to_whoever_asks_for_the_result(vsm, cameras, failure, told):
    cameras.failure = failure
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,)))
    cameras.go.set()
    with pytest.raises(told, match="are gone"):
        vsm.request("spot_find", SpotFindRequest((CAMERA,), look=name))


def test_a_look_outlives_the_client_that_ordered_it(vsm, cameras):
    living = [True]
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,)), lambda: living[0])
    living[0] = False
    cameras.go.set()
    (spot,) = vsm.request("spot_find", SpotFindRequest((CAMERA,), look=name)).spots
    assert spot.camera == CAMERA


def test_exposures_that_are_not_as_ordered_are_told_to_whoever_gets_the_spots(vsm, cameras):
    cameras.tick_s = 0.0045
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,), 0.006))
    cameras.go.set()
    for look in (name, name, ""):
        told = []
        vsm.request("spot_find", SpotFindRequest((CAMERA,), 0.006, look), tell=told.append)
        assert told == ["exposed for 0.0045 s, not for 0.006 s"]
    told = []
    vsm.request("spot_find", SpotFindRequest((CAMERA,), 0.018), tell=told.append)
    assert told == []


def test_who_waits_for_a_look_may_give_up(vsm, cameras):
    name = vsm.request("spot_look", SpotFindRequest((CAMERA,)))
    outcomes = []

    def wait():
        try:
            vsm.request("spot_find", SpotFindRequest((CAMERA,), look=name))
        except StateError as error:
            outcomes.append(error.message)

    waiting = threading.Thread(target=wait)
    waiting.start()
    while "spot_find #2" not in vsm.state().requests:
        pass
    vsm.cancel("spot_find #2")
    waiting.join(20.0)
    assert outcomes == ["spot_find #2 was cancelled, or its client has gone"]
    assert not cameras.go.is_set()


def test_what_cannot_be_exposed_is_no_look(vsm, cameras):
    with pytest.raises(NotFoundError, match="nose"):
        vsm.request("spot_look", SpotFindRequest(("nose",)))
    assert cameras.shut == 0


def test_a_look_that_is_not_known_or_by_other_cameras_is_refused():
    looks = Looks()
    with pytest.raises(StateError, match="look 7 is not known: its images are gone") as caught:
        looks.found("7", (CAMERA,), 1.0, patient)
    assert caught.value.code == FORGOTTEN
    looks.keep("7", Look((CAMERA,)))
    with pytest.raises(DataError, match="look 7 was by ceiling_left, not by wall"):
        looks.found("7", ("wall",), 1.0, patient)
    with pytest.raises(WaitTimeoutError, match=r"/vss to find the light in the images of ceiling_left \(look 7\)"):
        looks.found("7", (CAMERA,), 0.01, patient)


def test_of_many_looks_the_oldest_are_forgotten():
    looks = Looks()
    for number in range(MOST_LOOKS + 1):
        look = Look((CAMERA,))
        look.found.set_result(number)
        looks.keep(str(number), look)
    assert looks.found(str(MOST_LOOKS), (CAMERA,), 0.0, patient) == MOST_LOOKS
    assert looks.found("1", (CAMERA,), 0.0, patient) == 1
    with pytest.raises(StateError, match="look 0 is not known"):
        looks.found("0", (CAMERA,), 0.0, patient)


def test_a_look_of_a_name_that_was_used_before_is_the_newest():
    looks = Looks()
    for number in (*range(MOST_LOOKS), 0, MOST_LOOKS):
        look = Look((CAMERA,))
        look.found.set_result(number)
        looks.keep(str(number), look)
    assert looks.found("0", (CAMERA,), 0.0, patient) == 0
    with pytest.raises(StateError, match="look 1 is not known"):
        looks.found("1", (CAMERA,), 0.0, patient)
