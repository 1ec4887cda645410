"""Contention for the Vision Modules: many clients of every Service at once, some of which die.

DDS hands the answers of a Service to all its clients, each of which picks its own: a client's queue must hold what
comes in a burst, as that of ``qos.SERVICES`` does.
"""

import os
import signal
import threading
from collections import Counter

import numpy as np
import pytest
from sensor_msgs.msg import RegionOfInterest

from im_core import clock
from im_core.ros import qos
from im_msgs.srv import Calibrate, CircleFind, FiducialPose, LineFind, Snap, SpotFind, SpotFindStereo, VisionQuery
from im_vss.managers import VisionClient

CEILING = ["ceiling_left", "ceiling_right"]
REGION = RegionOfInterest(x_offset=200, y_offset=20, width=200, height=120)
REQUESTS = {
    "snap": (Snap, {"cameras": ["table"]}),
    "spot_find": (SpotFind, {"cameras": ["ceiling_left"]}),
    "spot_find_stereo": (SpotFindStereo, {"cameras": CEILING}),
    "circle_find": (CircleFind, {"camera": "ceiling_left", "region": REGION}),
    "line_find": (LineFind, {"camera": "ceiling_left", "region": REGION}),
    "fiducial_pose": (FiducialPose, {"cameras": ["ceiling_right"]}),
    "calibrate": (Calibrate, {"cameras": CEILING}),
}
CLIENTS, KILLED = 50, 5
MORTAL = """
import sys, time
import rclpy
from rclpy.node import Node
import im_msgs.srv
rclpy.init()
node, count = Node("mortal"), int(sys.argv[1])
for pair in sys.argv[2:]:
    name, kind, cameras = pair.split(":")
    kind = getattr(im_msgs.srv, kind)
    for _ in range(count):
        client = node.create_client(kind, f"/vss/{name}")
        assert client.wait_for_service(20.0)
        request = kind.Request()
        if hasattr(request, "cameras"):
            request.cameras = cameras.split(",")
        else:
            request.camera = cameras
        client.call_async(request)
print("asked", flush=True)
time.sleep(60.0)
"""


def mortal(process, python, count, names):
    """A process with clients of some Services, after it has asked."""
    pairs = []
    for name in names:
        kind, fields = REQUESTS[name]
        cameras = ",".join(fields.get("cameras", [fields.get("camera", "")]))
        pairs.append(f"{name}:{kind.__name__}:{cameras}")
    return process(python, "-c", MORTAL, count, *pairs)


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


def test_the_only_client_dies_and_its_place_in_the_queue_is_free(machine, process, python):
    """First in this module: nobody else is a client of the Service yet."""
    vmm = machine.vss._vsm.managers["image_processing"]
    with vmm.lend("vm_snap", VisionClient("somebody")):
        child = mortal(process, python, 3, ["line_find"])
        machine.until(lambda: len(vmm.state("vm_snap").queue) == 3)
        os.kill(child.pid, signal.SIGKILL)
        began = clock.monotonic()
        machine.until(lambda: vmm.state("vm_snap").queue == (), 20.0)
        assert clock.monotonic() - began < vmm.wait_s / 2.0
    machine.until(lambda: machine.vss._vsm.state().requests == ())


def test_fifty_clients_of_every_service_of_which_a_tenth_is_killed(machine, process, python, monkeypatch):
    machine.light(on=True)
    vsm, rig = machine.vss._vsm, machine.vss._rig
    take, raw = Counted(rig.source.take), Counted(rig.screen.raw)
    monkeypatch.setattr(rig.source, "take", take)
    monkeypatch.setattr(rig.screen, "raw", raw)
    child = mortal(process, python, KILLED, REQUESTS)
    machine.until(lambda: "asked" in child.out.read_text(), 40.0)
    clients = [
        (name, machine.client.create_client(kind, f"/vss/{name}", qos_profile=qos.SERVICES), kind.Request(**fields))
        for _ in range(CLIENTS - KILLED)
        for name, (kind, fields) in REQUESTS.items()
    ]
    machine.until(lambda: all(client.service_is_ready() for _, client, _ in clients))
    futures = [(name, client.call_async(request)) for name, client, request in clients]
    os.kill(child.pid, signal.SIGKILL)
    machine.until(lambda: all(future.done() for _, future in futures), 60.0)
    answers = [(name, future.result()) for name, future in futures]
    outcome = Counter((name, answer.success) for name, answer in answers)
    refused = "there is no observation to calibrate from"
    assert all(refused in answer.status.message for name, answer in answers if name == "calibrate")
    assert outcome == {(name, name != "calibrate"): CLIENTS - KILLED for name in REQUESTS}, {
        answer.status.message for _, answer in answers
    }
    assert (take.most, raw.most) == (1, 1)
    stamps = [image.header.stamp for name, answer in answers if name == "snap" for image in answer.images]
    assert len({(stamp.sec, stamp.nanosec) for stamp in stamps}) == CLIENTS - KILLED
    machine.until(lambda: vsm.state().requests == ())
    for module in machine.call(VisionQuery, "/vss/query").state.modules:
        assert (module.owner, module.queue) == ("", [])
        assert module.leases == module.released + module.lapsed
    for _, client, _ in clients:
        machine.client.destroy_client(client)


def test_a_wait_is_bounded_and_says_for_whom(machine):
    vmm = machine.vss._vsm.managers["image_processing"]
    with pytest.MonkeyPatch.context() as patch, vmm.lend("vm_snap", VisionClient("somebody")):
        patch.setattr(vmm, "wait_s", 0.3)
        answer = machine.call(Snap, "/vss/snap", cameras=["wall"])
    assert not answer.success
    assert "vm_snap, held by somebody, 0 before snap #" in answer.status.message
    assert np.any(np.frombuffer(machine.call(Snap, "/vss/snap", cameras=["wall"]).images[0].data, np.uint8))
