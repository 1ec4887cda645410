"""Contention for the Vision Modules: many clients of every Service at once, some of which die.

DDS hands the answers of a Service to all its clients, each of which picks its own: a client's queue must hold what
comes in a burst, as that of ``qos.SERVICES`` does.
"""

import json
import os
import signal
import threading
from collections import Counter, deque

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import RegionOfInterest

from bench.calibration.synthetic import Design, make_scene
from im_core import clock
from im_core.ros import qos
from im_msgs.srv import (
    Calibrate,
    CircleFind,
    FiducialPose,
    LaserCalibrate,
    LaserPoint,
    LaserSpot3d,
    LineFind,
    LineScan,
    Snap,
    SpotFind,
    SpotFindStereo,
    SpotLook,
    VisionQuery,
)
from im_vss.catalogue import load_catalogue
from im_vss.managers import VisionClient

CEILING = ["ceiling_left", "ceiling_right"]
REGION = RegionOfInterest(x_offset=240, y_offset=60, width=80, height=60)
REQUESTS = {
    "snap": (Snap, {"cameras": ["table"]}),
    "spot_find": (SpotFind, {"cameras": ["ceiling_left"]}),
    "spot_find_stereo": (SpotFindStereo, {"cameras": CEILING}),
    "spot_look": (SpotLook, {"cameras": ["ceiling_left"]}),
    "circle_find": (CircleFind, {"camera": "ceiling_left", "region": REGION}),
    "line_find": (LineFind, {"camera": "ceiling_left", "region": REGION}),
    "fiducial_pose": (FiducialPose, {"cameras": ["ceiling_right"]}),
    "laser_point": (LaserPoint, {"angles": [0.01, 0.02], "on": True}),
    "laser_spot_3d": (LaserSpot3d, {"cameras": CEILING, "angles": [0.1, 0.0]}),
    "line_scan": (LineScan, {"cameras": CEILING, "span": [0.06, 0.12], "sweep": [0.0, 0.0], "lines": 1}),
    "laser_calibrate": (LaserCalibrate, {"cameras": CEILING, "mirror1": [0.1], "mirror2": [0.05]}),
    "calibrate": (Calibrate, {}),  # with a synthetic scene, see `requests`
}
CLIENTS, KILLED = 12, 1
LONGEST_WAIT_S = 600.0
MORTAL = """
import json, sys, time
import rclpy
from rclpy.node import Node
from rclpy.serialization import deserialize_message
import im_msgs.srv
rclpy.init()
node = Node("mortal")
for name, kind, request in json.load(open(sys.argv[2])):
    kind = getattr(im_msgs.srv, kind)
    for _ in range(int(sys.argv[1])):
        client = node.create_client(kind, f"/vss/{name}")
        assert client.wait_for_service(60.0)
        client.call_async(deserialize_message(bytes.fromhex(request), kind.Request))
print("asked", flush=True)
time.sleep(60.0)
"""


@pytest.fixture(scope="module")
def requests(calibration_request):
    """A request for each Service of the catalogue, by name: its type and the message."""
    small = calibration_request(make_scene(Design(poses=12), 2).problem)
    given = {**REQUESTS, "calibrate": (Calibrate, small)}
    for name in load_catalogue().services:
        assert name in given, f"the Service '{name}' of the catalogue has no request in REQUESTS of this file: add one"
    return {name: (given[name][0], given[name][0].Request(**given[name][1])) for name in load_catalogue().services}


@pytest.fixture
def mortal(process, python, tmp_path, requests):
    """``mortal(count, names)``: a process with clients of some Services, which ask and never read their answers."""

    def start(count, names):
        asked = [(name, requests[name][0].__name__, serialize_message(requests[name][1]).hex()) for name in names]
        (tmp_path / "requests.json").write_text(json.dumps(asked))
        return process(python, "-c", MORTAL, count, tmp_path / "requests.json")

    return start


class Counted:
    """Wraps a call and counts how many are in it at once."""

    def __init__(self, call):
        self.call, self.lock, self.inside, self.most, self.calls = call, threading.Lock(), 0, 0, 0

    def __call__(self, *arguments):
        with self.lock:
            self.inside += 1
            self.calls += 1
            self.most = max(self.most, self.inside)
        try:
            return self.call(*arguments)
        finally:
            with self.lock:
                self.inside -= 1


class Witness:
    """Writes down who came to a Vision Module's queue, and who was in the Module; see :meth:`watch`."""

    def __init__(self):
        self.came, self.served, self.waits = [], [], []

    @classmethod
    def watch(cls, patch, vmm, name, module):
        """Look at a module of a manager, from the inside: its queue, and the work it is given under each lease."""
        witness, run, last = cls(), module.run, []

        class Queue(deque):
            def append(self, client):
                witness.came.append((client.name, len(self) + 1, len(witness.served), clock.monotonic()))
                super().append(client)

        def served(lease, work):
            if last[-1:] != [lease]:
                last.append(lease)
                witness.waits.append(clock.monotonic() - witness.came[len(witness.served)][3])
                witness.served.append(lease.client.name)
            return run(lease, work)

        patch.setitem(vmm._queues, name, Queue())
        patch.setattr(module, "run", served)
        return witness

    def check(self):
        """First come, first served; so nobody waits for more than those who were there before, in and at the Module."""
        assert self.served == [name for name, *_ in self.came]
        for place, (name, ahead, served, _) in enumerate(self.came):
            assert place - served <= ahead, f"{name} waited for {place - served} others, {ahead} were before it"


def test_the_only_client_dies_and_its_place_in_the_queue_is_free(machine, mortal, monkeypatch):
    """First in this module: nobody else is a client of the Service yet. What frees the place is its death, not time."""
    vmm = machine.vss._vsm.managers["image_processing"]
    monkeypatch.setattr(vmm, "wait_s", 600.0)
    with vmm.lend("vm_snap", VisionClient("somebody")):
        child = mortal(3, ["line_find"])
        machine.until(lambda: len(vmm.state("vm_snap").queue) == 3)
        os.kill(child.pid, signal.SIGKILL)
        machine.until(lambda: vmm.state("vm_snap").queue == (), 60.0)
    machine.until(lambda: machine.vss._vsm.state().requests == ())


def test_many_clients_of_every_service_of_which_one_is_killed(machine, mortal, requests, monkeypatch):
    machine.calibrate_cameras(*CEILING)
    machine.light(on=True)
    vsm, rig = machine.vss._vsm, machine.vss._rig
    hardware = [(rig.source, "take_frames"), (rig.screen, "raw"), (rig.monitors, "draw"), (rig.laser.scanner, "drive")]
    counted = [Counted(getattr(*place)) for place in hardware]
    for place, count in zip(hardware, counted, strict=True):
        monkeypatch.setattr(*place, count)
    before, witnesses = vsm.state().modules, {}
    for name, (manager, _) in before.items():
        vmm = vsm.managers[manager]
        monkeypatch.setattr(vmm, "wait_s", LONGEST_WAIT_S)  # a slow computer takes longer for all than is usual for one
        monkeypatch.setitem(vmm._longest, name, LONGEST_WAIT_S)
        witnesses[name] = Witness.watch(monkeypatch, vmm, name, vsm.modules[name])
    child = mortal(KILLED, requests)
    machine.until(lambda: "asked" in child.out.read_text(), LONGEST_WAIT_S)
    clients = [
        (name, machine.client.create_client(kind, f"/vss/{name}", qos_profile=qos.SERVICES), request)
        for _ in range(CLIENTS - KILLED)
        for name, (kind, request) in requests.items()
    ]
    machine.until(lambda: all(client.service_is_ready() for _, client, _ in clients), LONGEST_WAIT_S)
    futures = [(name, client.call_async(request)) for name, client, request in clients]
    os.kill(child.pid, signal.SIGKILL)
    machine.until(lambda: all(future.done() for _, future in futures), LONGEST_WAIT_S)
    machine.until(lambda: vsm.state().requests == (), LONGEST_WAIT_S)
    answers = [(name, future.result()) for name, future in futures]
    outcome = Counter((name, answer.success) for name, answer in answers)
    causes = {answer.status.message for _, answer in answers}
    assert outcome == {(name, True): CLIENTS - KILLED for name in requests}, causes
    assert [(count.most, count.calls > CLIENTS) for count in counted] == [(1, True)] * len(hardware)
    for name, witness in witnesses.items():
        witness.check()
        assert len(witness.served) >= CLIENTS, name
        assert max(witness.waits) < LONGEST_WAIT_S
    stamps = [image.header.stamp for name, answer in answers if name == "snap" for image in answer.images]
    assert len({(stamp.sec, stamp.nanosec) for stamp in stamps}) == CLIENTS - KILLED
    points = [answer.point.point for name, answer in answers if name == "laser_spot_3d"]
    assert np.ptp([(p.x, p.y, p.z) for p in points], axis=0).max() < 0.005  # no mirror moved between two frames
    assert all(answer.report.success for name, answer in answers if name == "calibrate")
    for module in machine.call(VisionQuery, "/vss/query").state.modules:
        assert (module.owner, module.queue) == ("", [])
        given = module.leases - before[module.name][1].leases
        assert given == module.released - before[module.name][1].released == len(witnesses[module.name].served)
    for _, client, _ in clients:
        machine.client.destroy_client(client)


@pytest.mark.parametrize(
    ("manager", "module", "service"),
    [("image_processing", "vm_snap", "snap"), ("laser_scanner", "vm_laser", "laser_point")],
)
def test_a_wait_is_bounded_and_says_for_whom(machine, requests, manager, module, service):
    vmm, (kind, request) = machine.vss._vsm.managers[manager], requests[service]
    fields = {field: getattr(request, field) for field in request.get_fields_and_field_types()}
    other = "laser_point" if service == "snap" else "snap"
    with pytest.MonkeyPatch.context() as patch, vmm.lend(module, VisionClient("somebody")):
        patch.setattr(vmm, "wait_s", 0.3)
        answer = machine.call(kind, f"/vss/{service}", **fields)
        assert not answer.success
        assert f"{module}, held by somebody, 0 before {service} #" in answer.status.message
        assert machine.call(REQUESTS[other][0], f"/vss/{other}", **REQUESTS[other][1]).success  # the other's business
    assert machine.call(kind, f"/vss/{service}", **fields).success
    assert machine.vss._vsm.managers[manager].state(module).owner == ""
