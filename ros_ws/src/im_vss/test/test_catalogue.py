"""Only the closure of the Services in use is loaded; requests are routed by name."""

import numpy as np
import pytest
import yaml

from im_cell.frames import Frame, FrameSet, nobody
from im_cell.robot import load_cell
from im_core.errors import ConfigError, NotFoundError
from im_vss.camera_book import CameraBook
from im_vss.catalogue import Catalogue, load_catalogue
from im_vss.rig import Rig
from im_vss.services.snap import SnapRequest
from im_vss.services.spot import SpotFindRequest
from im_vss.settings import load_settings
from im_vss.vsm import VisionServicesManager

CELL = load_cell()


class Cameras:
    """Hands out grey images; the light is a block of bright pixels."""

    def __init__(self):
        self.orders = []

    def take_frames(self, order, exposed=nobody):
        self.orders.append(order)
        frames = {}
        for camera in order.cameras:
            images = []
            for number, blank in enumerate(order.blank_light):
                image = np.full((480, 640), 40, np.uint8)
                if not blank:
                    rows, columns = np.mgrid[:480, :640]
                    spot = 150.0 * np.exp(-((columns - 200.25) ** 2 + (rows - 100.5) ** 2) / (2 * 1.2**2))
                    image += np.rint(spot).astype(np.uint8)
                images.append(Frame(camera, image, 1000 + number, blank))
            frames[camera] = tuple(images)
        return FrameSet(frames, {"expose_s": 0.0}, order.exposure_s)


class Screen:
    """Remembers what it was shown."""

    def __init__(self):
        self.frames, self.displays, self.spots = [], [], []

    def raw(self, frame):
        self.frames.append(frame)

    def display(self, camera, image, stamp_ns):
        self.displays.append((camera, image, stamp_ns))

    def spot(self, camera, place, stamp_ns):
        self.spots.append((camera, place, stamp_ns))


@pytest.fixture
def system(tmp_path):
    def build(*services):
        settings = load_settings(CELL)
        if services:
            settings = settings.model_copy(update={"services": services})
        rig = Rig(settings, CELL, CameraBook(CELL, settings.cameras, tmp_path), Cameras(), Screen())
        systems.append(VisionServicesManager(rig, load_catalogue()))
        return systems[-1], rig

    systems = []
    yield build
    for made in systems:
        made.close()


def test_closure_of_one_service(system):
    vsm, _ = system("snap")
    assert list(vsm.services) == ["snap"]
    assert set(vsm.tools) == {"tool_snap", "tool_image_disp"}
    assert set(vsm.modules) == {"vm_snap", "vm_image_disp"}
    assert set(vsm.managers) == {"image_processing"}
    with pytest.raises(NotFoundError, match="no vision service 'spot_find'"):
        vsm.request("spot_find", SpotFindRequest(("wall",)))


def test_names_of_classes_and_catalogue_agree(system):
    vsm, _ = system()
    for table in (vsm.services, vsm.tools, vsm.modules):
        assert all(thing.name == name for name, thing in table.items())


def test_spot_find_calls_its_four_tools(system):
    vsm, rig = system()
    result = vsm.request("spot_find", SpotFindRequest(("ceiling_left", "wall"), 0.009))
    assert [spot.camera for spot in result.spots] == ["ceiling_left", "wall"]
    for spot in result.spots:
        assert spot.stamp_ns == 1001
        assert (spot.finding.spot.u, spot.finding.spot.v) == pytest.approx((200.25, 100.5), abs=0.01)
    assert rig.screen.spots == [
        (spot.camera, (spot.finding.spot.u, spot.finding.spot.v), spot.stamp_ns) for spot in result.spots
    ]
    (order,) = rig.source.orders
    assert (order.blank_light, order.exposure_s) == ((True, False), 0.009)
    assert [frame.stamp_ns for frame in rig.screen.frames] == [1000, 1001] * 2
    camera, image, stamp = rig.screen.displays[0]
    assert (camera, image.shape, stamp) == ("ceiling_left", (480, 640, 3), 1001)
    assert image[100, 210, 1] > image[100, 210, 0] + 50
    assert image[100, 200].tolist() == [rig.screen.frames[1].image[100, 200]] * 3


def test_snap_is_one_exposure_with_the_lights_as_commanded(system):
    vsm, rig = system()
    result = vsm.request("snap", SnapRequest(("table",)))
    assert [frame.camera for frame in result.frames] == ["table"]
    assert (rig.source.orders[0].blank_light, rig.source.orders[0].exposure_s) == ((False,), 0.018)


def test_references_of_a_catalogue_are_checked():
    content = yaml.safe_load(
        """
        services: {a: {implementation: "m:A", port: "m:P", tools: [t], process: vss}}
        tools: {t: {implementation: "m:T", modules: [vm]}}
        modules: {vm: {implementation: "m:V", manager: nobody}}
        managers: {image_processing: x}
        processes: {vss: {host: localhost}}
        """
    )
    with pytest.raises(ValueError, match=r"modules.vm.manager: 'nobody' is not one of image_processing"):
        Catalogue.model_validate(content)


def test_software_that_is_missing_is_named(system):
    _, rig = system()
    catalogue = load_catalogue()
    tool = catalogue.tools["tool_snap"].model_copy(update={"implementation": "im_vss.tools.tool_snip:ToolSnip"})
    broken = catalogue.model_copy(update={"tools": {**catalogue.tools, "tool_snap": tool}})
    with pytest.raises(ConfigError, match=r"im_vss\.tools\.tool_snip:ToolSnip' cannot be loaded"):
        VisionServicesManager(rig, broken)
