"""What the monitors show: what was found is drawn where it truly is."""

import cv2
import numpy as np
import pytest

from im_cell.camera_covariance import CameraCovariance
from im_cell.frames import Frame, FrameSet, nobody
from im_vss.camera_book import CameraBook
from im_vss.catalogue import load_catalogue
from im_vss.monitor import Curve, Marker, Monitors
from im_vss.rig import Rig
from im_vss.services.features import CircleFindRequest, FiducialPoseRequest, LineFindRequest
from im_vss.vsm import VisionServicesManager

CAMERA = "ceiling_left"
KNOWN = CameraCovariance((f"{CAMERA}.fx",), np.array([[1e-6]]))


class Screen:
    """Keeps what a monitor shows last."""

    picture = None

    def raw(self, frame):
        pass

    def display(self, camera, image, stamp_ns):
        self.picture = image


class Camera:
    """Takes the same scene each time."""

    def __init__(self, plates):
        self.plates = plates

    def take_frames(self, order, exposed=nobody):
        frame = Frame(CAMERA, self.plates.image(1), 1000, order.blank_light[0])
        return FrameSet({CAMERA: (frame,)}, {"expose_s": 0.0}, order.exposure_s)


@pytest.fixture
def shown(plates, tmp_path):
    """``shown(service, request)``: the result, and what the camera's monitor shows after it."""
    book = CameraBook(plates.cell, plates.settings.cameras, tmp_path)
    screen = Screen()
    vsm = VisionServicesManager(Rig(plates.settings, plates.cell, book, Camera(plates), screen), load_catalogue())

    def ask(service, request, calibrated=True):
        if calibrated:
            book.set_cameras({CAMERA: plates.camera}, KNOWN)
        screen.picture = None
        return vsm.request(service, request), screen.picture

    yield ask
    vsm.close()


def places(plates, name, points):
    """Where points of a plate, shape (n, 3) [m], truly are in the image."""
    target = next(target for target in plates.cell.targets if target.name == name)
    rotation, position = target.pose()
    return plates.camera.project(position + np.asarray(points) @ rotation.T)


def drawn_share(picture, pixels, colour):
    """Share of places within 1.5 px of which something of about a colour is drawn; the scene is grey."""
    distance = np.abs(picture.astype(int) - colour).max(axis=2)
    near = cv2.erode(distance.astype(np.float32), np.ones((3, 3)))
    columns, rows = np.rint(pixels).astype(int).T
    return float(np.mean(near[rows, columns] < 110))


def test_circles_are_outlined(shown, plates):
    result, picture = shown("circle_find", CircleFindRequest(CAMERA))
    assert len(result.found) == 1
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    rim = np.stack((0.08 * np.cos(turn), 0.08 * np.sin(turn), np.zeros(200)), axis=1)
    assert drawn_share(picture, places(plates, "table_disc", rim), (40, 255, 60)) > 0.95
    assert drawn_share(picture, places(plates, "table_disc", 1.4 * rim), (40, 255, 60)) < 0.3  # the cross


def test_straight_edges_are_drawn_as_bent_as_the_lens_bends_them(shown, plates):
    result, picture = shown("line_find", LineFindRequest(CAMERA))
    assert result.found
    along = np.linspace(-0.14, 0.14, 100)
    edge = np.stack((np.zeros(100), along, np.zeros(100)), axis=1)
    assert drawn_share(picture, places(plates, "table_edge", edge), (40, 255, 60)) > 0.95


def test_fiducials_have_outline_axes_and_number(shown, plates):
    result, picture = shown("fiducial_pose", FiducialPoseRequest((CAMERA,), ids=(7,)))
    assert [seen.fit.target.id for seen in result.found] == [7]
    along = np.linspace(0.01, 0.115, 60)
    for axis, colour in enumerate(((255, 70, 60), (40, 255, 60), (80, 150, 255))):
        points = np.zeros((60, 3))
        points[:, axis] = along
        assert drawn_share(picture, places(plates, "table_tag", points), colour) > 0.9
    side = np.stack((np.linspace(-0.12, 0.12, 60), np.full(60, 0.12), np.zeros(60)), axis=1)
    assert drawn_share(picture, places(plates, "table_tag", side), (40, 255, 60)) > 0.9


def test_a_camera_as_drawn_gives_marks_but_no_pose_and_lines_with_a_remark(shown):
    poses, picture = shown("fiducial_pose", FiducialPoseRequest((CAMERA,), ids=(7,)), calibrated=False)
    assert poses.found == ()
    assert poses.cause == "no pose from ceiling_left: its lens is not calibrated"
    assert np.ptp(picture, axis=2).max() > 100  # colours on a grey scene
    lines, _ = shown("line_find", LineFindRequest(CAMERA), calibrated=False)
    assert "the lens of ceiling_left is not calibrated" in lines.remark
    lines, _ = shown("line_find", LineFindRequest(CAMERA))
    assert lines.remark == ""


def test_what_lies_out_of_all_bounds_is_not_drawn():
    monitors = Monitors()
    monitors.show(Frame(CAMERA, np.full((480, 640), 40, np.uint8), 1, False))
    wild = tuple(Curve(np.array([[10.0, 10.0], [value, 20.0]])) for value in (np.nan, np.inf, 1e12))
    bare, drawn = (monitors.draw(Marker(CAMERA, "", ((50.0, 50.0),), curves)) for curves in ((), wild))
    np.testing.assert_array_equal(bare.image, drawn.image)
    assert monitors.draw(Marker("wall", "dark")) is None
