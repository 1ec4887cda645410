"""Many clients of the laser scanner at once: one in the hardware, leases that come back."""

import numpy as np
import pytest

from im_core.ros import qos
from im_msgs.srv import LaserCalibrate, LaserPoint, LaserSpot3d, LineScan, Snap, SpotFind, VisionQuery
from im_vss.managers import VisionClient

CEILING = ["ceiling_left", "ceiling_right"]
SPAN, SWEEP = [0.06, 0.12], [-0.06, 0.06]


def place(point):
    return [point.x, point.y, point.z]


def test_many_clients_at_once_and_one_in_the_hardware(machine, monkeypatch):
    machine.calibrate_cameras(*CEILING)
    rig, inside, most = machine.vss._rig, [], []

    def counted(call, what):
        def wrapped(*arguments):
            inside.append(what)
            most.append(inside.count(what))
            try:
                return call(*arguments)
            finally:
                inside.remove(what)

        return wrapped

    monkeypatch.setattr(rig.laser.scanner, "drive", counted(rig.laser.scanner.drive, "mirrors"))
    monkeypatch.setattr(rig.source, "take", counted(rig.source.take, "cameras"))
    asked = {
        "laser_point": (LaserPoint, {"angles": [0.01, 0.02], "on": True}),
        "laser_spot_3d": (LaserSpot3d, {"cameras": CEILING, "angles": [0.1, 0.0]}),
        "line_scan": (LineScan, {"cameras": CEILING, "span": SPAN, "sweep": SWEEP, "lines": 1}),
        "laser_calibrate": (LaserCalibrate, {"cameras": CEILING, "mirror1": [0.1], "mirror2": [0.05]}),
        "spot_find": (SpotFind, {"cameras": ["wall"]}),
    }
    futures = []
    for name, (kind, fields) in asked.items():
        client = machine.client.create_client(kind, f"/vss/{name}", qos_profile=qos.SERVICES)
        machine.until(client.service_is_ready)
        futures += [client.call_async(kind.Request(**fields)) for _ in range(8)]
    machine.until(lambda: all(future.done() for future in futures))
    answers = [future.result() for future in futures]
    assert all(answer.success for answer in answers), {answer.status.message for answer in answers}
    spots = np.array([place(answer.point.point) for answer in answers if hasattr(answer, "epipolar_distance")])
    assert len(spots) == 8
    assert np.ptp(spots, axis=0).max() < 0.005  # nobody moved a mirror between two frames
    assert (len(most) > 40, max(most)) == (True, 1)


def test_a_busy_scanner_says_for_whom_and_leases_come_back(machine):
    vmm = machine.vss._vsm.managers["laser_scanner"]
    with pytest.MonkeyPatch.context() as patch, vmm.lend("vm_laser", VisionClient("somebody")):
        patch.setattr(vmm, "wait_s", 0.3)
        answer = machine.call(LaserPoint, "/vss/laser_point", angles=[0.0, 0.0])
        assert not answer.success
        assert "vm_laser, held by somebody, 0 before laser_point #" in answer.status.message
        assert machine.call(Snap, "/vss/snap", cameras=["wall"]).success  # the other manager's business
    assert machine.call(LaserPoint, "/vss/laser_point", angles=[0.0, 0.0]).success
    (state,) = [m for m in machine.call(VisionQuery, "/vss/query").state.modules if m.name == "vm_laser"]
    assert (state.manager, state.owner, state.queue) == ("laser_scanner", "", [])
    assert state.leases == state.released > 30
