"""The Vision Services Manager: cancelling, what is loaded and owned, processes and their deployment."""

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from bench.calibration.synthetic import Design, make_scene
from im_calibration import Observation, SeenSpot
from im_cell.camera_covariance import CameraCovariance
from im_cell.frames import FrameSet, nobody
from im_cell.robot import load_cell
from im_core import clock
from im_core.errors import DataError, ImError, NotFoundError, StateError
from im_vss import deployment
from im_vss.camera_book import CameraBook
from im_vss.catalogue import Catalogue, load_catalogue
from im_vss.rig import Rig
from im_vss.services.calibrate import CalibrateRequest
from im_vss.services.snap import SnapRequest
from im_vss.settings import load_settings
from im_vss.vsm import VisionServicesManager

CELL = load_cell()


class SlowCameras:
    """Deliver nothing until they are told to."""

    def __init__(self):
        self.go, self.inside, self.most = threading.Event(), 0, 0

    def take_frames(self, order, exposed=nobody):
        self.inside += 1
        self.most = max(self.most, self.inside)
        self.go.wait(60.0)
        self.inside -= 1
        return FrameSet(dict.fromkeys(order.cameras, ()), {}, order.exposure_s)


class Screen:
    """Dark."""

    def raw(self, frame):
        """Nothing is shown."""

    def display(self, camera, image, stamp_ns):
        """Nothing is shown."""

    def spot(self, camera, place, stamp_ns):
        """Nothing is put out."""


@pytest.fixture
def system(tmp_path):
    settings = load_settings(CELL)
    source = SlowCameras()
    vsm = VisionServicesManager(
        Rig(settings, CELL, CameraBook(CELL, settings.cameras, tmp_path), source, Screen()), load_catalogue()
    )
    yield vsm, source
    source.go.set()
    vsm.close()


def ask(vsm, outcomes):
    def run():
        try:
            vsm.request("snap", SnapRequest(("wall",)))
        except (StateError, IndexError) as error:
            outcomes.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def until(condition):
    deadline = clock.monotonic() + 60.0
    while not condition():
        assert clock.monotonic() < deadline
        clock.sleep(0.002)


def test_state_says_who_owns_and_who_waits(system):
    vsm, source = system
    outcomes, threads = [], []
    for number in range(3):
        threads.append(ask(vsm, outcomes))
        until(lambda number=number: len(vsm.state().requests) == number + 1)
    until(lambda: len(vsm.state().modules["vm_snap"][1].queue) == 2)
    state = vsm.state()
    manager, module = state.modules["vm_snap"]
    assert (manager, module.owner, module.queue) == ("image_processing", "snap #1", ("snap #2", "snap #3"))
    assert 0.0 < module.remaining_s <= 30.0
    assert set(state.services) == set(load_settings(CELL).services)
    source.go.set()
    for thread in threads:
        thread.join()
    assert source.most == 1
    module = vsm.state().modules["vm_snap"][1]
    assert (module.owner, module.leases, module.released, module.lapsed) == ("", 3, 3, 0)
    assert vsm.state().requests == ()


def test_a_cancelled_request_leaves_the_queue_and_the_module(system):
    vsm, source = system
    outcomes, threads = [], []
    for number in range(2):
        threads.append(ask(vsm, outcomes))
        until(lambda number=number: len(vsm.state().requests) == number + 1)
    until(lambda: vsm.state().modules["vm_snap"][1].queue == ("snap #2",))
    vsm.cancel("snap #2")
    threads[1].join()
    assert "snap #2 gave up waiting for vm_snap" in outcomes[0].message
    vsm.cancel("snap #1")
    assert vsm.state().modules["vm_snap"][1].owner == ""
    source.go.set()
    threads[0].join()
    assert isinstance(outcomes[1], StateError)
    assert vsm.state().modules["vm_snap"][1].lapsed == 1
    with pytest.raises(NotFoundError, match="no request under way 'snap #1'"):
        vsm.cancel("snap #1")


def observation():
    """One of the wall's camera."""
    problem = make_scene(Design(poses=7), 1).problem
    seen = {"wall": SeenSpot(problem.spots[0, 0], np.eye(2), 1000)}
    return Observation("p", problem.positions[0], np.eye(3), problem.position_covariances[0], seen)


def test_calibrations_take_turns_and_the_second_does_not_wait_for_ever(system, monkeypatch):
    """Without turns 50 calibrations at once share the time of one, and everything else waits for all of them."""
    vsm, _ = system
    began, go, outcomes = threading.Event(), threading.Event(), []

    def slow(problem):
        began.set()
        go.wait(60.0)
        raise DataError("solved, after a fashion")

    monkeypatch.setattr("im_vss.modules.solver.calibrate_possible", slow)
    for manager in vsm.managers.values():
        monkeypatch.setattr(manager, "wait_s", 0.2)

    def run():
        try:
            vsm.request("calibrate", CalibrateRequest(("wall",), (observation(),)))
        except ImError as error:
            outcomes.append(error.message)

    first = threading.Thread(target=run)
    first.start()
    assert began.wait(60.0)
    assert vsm.state().modules["vm_solver"][1].owner == "calibrate #1"
    run()
    assert "vm_solver, held by calibrate #1, 0 before calibrate #2" in outcomes[0]
    go.set()
    first.join()
    assert outcomes[1:] == ["solved, after a fashion"]


@pytest.mark.parametrize("meanwhile", ["it is computed", "its files are written"])
def test_a_cancelled_calibration_changes_no_camera(system, monkeypatch, tmp_path, meanwhile):
    """Whether somebody gives it up while the solver has it, or right before the cameras are set."""
    vsm, _ = system
    rig = vsm.services["calibrate"].rig
    before, began, go, outcomes = rig.book.entries(), threading.Event(), threading.Event(), []
    moved = replace(rig.book["wall"].model, t_cam_base=np.array([1.0, 2.0, 3.0]))
    found = SimpleNamespace(
        usable=True,
        cameras=(SimpleNamespace(name="wall", model=moved),),
        camera_covariance=CameraCovariance(),
        residuals=np.zeros((1, 1, 2)),
    )

    def slow(*_):
        began.set()
        go.wait(60.0)
        return found

    def run():
        try:
            vsm.request("calibrate", CalibrateRequest(("wall",), (observation(),), (), tmp_path, apply=True))
        except ImError as error:
            outcomes.append(error.message)

    computed = meanwhile == "it is computed"
    monkeypatch.setattr("im_vss.modules.solver.calibrate_possible", slow if computed else lambda problem: found)
    monkeypatch.setattr("im_vss.services.calibrate.write_calibration", slow)
    asked = threading.Thread(target=run)
    asked.start()
    assert began.wait(60.0)
    vsm.cancel("calibrate #1")
    if computed:
        asked.join()  # it is not waited for
    go.set()
    asked.join()
    assert outcomes == ["calibrate #1 was cancelled, or its client has gone"]
    assert rig.book.entries() == before


def test_a_calibration_that_is_in_use_was_not_cancelled(system, monkeypatch):
    """It is too late to give it up, also for a client that dies, when its files are written and told of."""
    vsm, _ = system
    rig, living = vsm.services["calibrate"].rig, [True]
    moved = replace(rig.book["wall"].model, t_cam_base=np.array([1.0, 2.0, 3.0]))
    found = SimpleNamespace(
        usable=True,
        cameras=(SimpleNamespace(name="wall", model=moved),),
        camera_covariance=CameraCovariance(),
        residuals=np.zeros((1, 1, 2)),
    )
    monkeypatch.setattr("im_vss.modules.solver.calibrate_possible", lambda problem: found)
    monkeypatch.setattr("im_vss.services.calibrate.report_of", lambda *_: {})

    def told():
        living[0] = False
        with pytest.raises(StateError, match="calibrate #1 has ended and cannot be cancelled"):
            vsm.cancel("calibrate #1")

    rig.book.on_change = told
    request = CalibrateRequest(("wall",), (observation(),), (), None, apply=True)
    assert vsm.request("calibrate", request, lambda: living[0]).applied
    assert rig.book["wall"].model.t_cam_base.tolist() == [1.0, 2.0, 3.0]


def test_the_deployment_of_the_services_in_use(capsys):
    assert deployment.main(["snap", "calibrate"]) == 0
    (task,) = yaml.safe_load(capsys.readouterr().out)["hosts"]["localhost"]["vss"].values()
    assert task["parameters"] == {"calibration": "${calibration}"}
    assert (task["package"], task["executable"], task["node"]) == ("im_vss", "vss", "/vss")
    assert deployment.main(["snip"]) == 1
    assert "no vision service 'snip'; did you mean 'snap'" in capsys.readouterr().err


CONTENT = """
services:
  a: {implementation: "m:A", port: "m:P", tools: [t], process: vss}
  b: {implementation: "m:B", port: "m:P", tools: [u], process: vss_far}
tools:
  t: {implementation: "m:T", modules: [vm]}
  u: {implementation: "m:T", modules: []}
modules:
  vm: {implementation: "m:V", manager: image_processing}
managers: {image_processing: x}
processes:
  vss: {host: localhost}
  vss_far: {host: far}
"""


def test_services_go_to_their_processes_and_hosts():
    catalogue = Catalogue.model_validate(yaml.safe_load(CONTENT))
    assert list(catalogue.in_process("vss_far").services) == ["b"]
    assert catalogue.in_process("vss_far").modules == {}
    assert set(catalogue.deployment()) == {"localhost", "far"}
    far = catalogue.deployment(Path("/lab/mine.yaml"))["far"]["vss_far"]["vss_far"]
    assert (far["executable"], far["node"], far["parameters"]) == (
        "vss_apart", "/vss_far", {"catalogue": "/lab/mine.yaml"}
    )  # fmt: skip
    assert set(catalogue.closure(["a"]).deployment()) == {"localhost"}
    with pytest.raises(NotFoundError, match="no process of the vision services 'vss_near'"):
        catalogue.in_process("vss_near")


@pytest.mark.parametrize(
    ("manager", "sentence"),
    [
        ("computation", "services.b.process: 'vss_far' uses vm, which 'vss' owns"),
        ("laser_scanner", "'vss_far' uses vm of the laser_scanner, which is in 'vss' with the cameras"),
    ],
)
def test_a_module_has_one_process(manager, sentence):
    content = yaml.safe_load(CONTENT)
    content["tools"]["u"]["modules"] = ["vm"]
    content["managers"] = {manager: "x"}
    content["modules"]["vm"]["manager"] = manager
    with pytest.raises(ValueError, match=sentence):
        Catalogue.model_validate(content)
