"""What the Vision Coordinator decides."""

import numpy as np
import pytest

from im_cell.robot import load_cell
from im_cell.rotations import cross_matrix
from im_coordinators.ros.vision import VisionFunctions
from im_coordinators.vision import require_spot
from im_core.config import package_file
from im_core.errors import DataError, ImError, LinkError
from im_mcs.model import CellModel
from im_msgs.msg import GroupState
from im_pnt.execution.functions import ActionContext
from im_pnt.execution.jobs import Activity
from im_pnt.model.action import ServiceAction
from im_pnt.netfile import load_net, parse_net
from support.process import Process, hold


@pytest.mark.parametrize(
    ("causes", "expected"),
    [
        (["too faint: snr 3.1 < 6"], True),
        (["too faint: snr 3.1 < 6", "3 candidates of equal rank"], True),
        (["blocked: nothing brighter than the noise"], False),
        (["too faint: snr 3.1 < 6", "light is off"], False),
        ([], False),
    ],
)
def test_only_what_exposure_can_mend_is_too_faint(causes: list[str], expected: bool) -> None:
    with pytest.raises(DataError, match="no camera sees the light") as caught:
        require_spot({str(number): cause for number, cause in enumerate(causes)}, len(causes))
    assert (caught.value.code == "spot_too_faint") is expected


def test_one_camera_that_sees_the_light_is_enough() -> None:
    require_spot({"wall": "too faint"}, 2)
    with pytest.raises(DataError, match="no camera sees the light: wall: too faint; floor: blocked") as caught:
        require_spot({"wall": "too faint", "floor": "blocked"}, 2)
    assert (caught.value.code, caught.value.facts["causes"]) == ("spot_not_found", ["too faint", "blocked"])


ASKS = """
net: asks
places: {idle: {tokens: 1, resource: true}, done: , bad: }
escalate: bad
transitions:
  ask:
    symbol: go
    in: idle
    out: done
    request: {to: vision_coordinator.SERVICE, arguments: ARGUMENTS}
  end: {in: done, out: idle, emit: go_done}
  fail: {in: bad, out: idle, emit: go_failed}
"""
GONE = LinkError("vss is missing (it died and was started again meanwhile)")
NONE = ImError("there is no estimate", code="degenerate")


CALIBRATE = "calibrate", "{cameras: [wall], observations: [1], directory: there}", "do_calibrate", "calibrate_again"
SPOT = "find_spot", "{cameras: [wall], light: left_led, exposure: 0.5}", "do_find_spot", "find_again"
OBJECT = "find_object", "{name: part, camera: wrist_left}", "do_find_object", "find_object_again"


@pytest.mark.parametrize("service", [CALIBRATE, SPOT, OBJECT], ids=lambda service: service[0])
@pytest.mark.parametrize(
    ("answers", "tries", "failure"),
    [([None], 1, None), ([GONE, None], 2, None), ([GONE, GONE], 2, GONE), ([NONE], 1, NONE)],
    ids=["there", "died once", "died twice", "no estimate"],
)
def test_vss_is_asked_once_more_where_it_has_died(service, answers, tries, failure) -> None:
    name, arguments, *asked = service
    sent, left = [], list(answers)

    async def perform(activity: Activity, _: ActionContext) -> dict[str, object]:
        sent.append(activity.transition)
        if (error := left.pop(0)) is not None:
            raise error
        return {}

    net = load_net(package_file("im_coordinators", "nets/vision_coordinator.yaml"))
    functions = dict.fromkeys(("light_on", "light_as_found", "forget_light", "look_exposure", "nominal_exposure"), hold)
    functions |= dict.fromkeys(("longer_exposure", "store_spots", "keep_observation", "store_calibration"), hold)
    functions |= dict.fromkeys(("wanted_print", "locate_object"), hold)
    process = Process(
        [net, parse_net(ASKS.replace("SERVICE", name).replace("ARGUMENTS", arguments))],
        actions={**functions, "calibration_problem": lambda ctx: {}},
        others={ServiceAction: perform},
    )
    process.command("asks", "go")
    (ended,) = process.results
    assert sent == asked[:tries]
    assert ended.error is failure


def test_place_and_turn_of_a_wrist_move_with_the_errors_of_the_arm_as_its_points_do() -> None:
    cell = load_cell()
    vision, home = VisionFunctions(None), cell.groups["left"].home  # a host that is not asked
    position = GroupState(group="left", joints=list(cell.joints_of("left")), q_rest=list(home))
    scene = CellModel(cell)
    rotation = scene.pose(cell.home, "left_wrist").rotation
    twist = vision._wrist_by_arm(position, rotation)
    offset = np.array([0.1, -0.2, 0.3])
    by_point = vision._by_arm(position, offset)
    np.testing.assert_allclose(twist[:3] - cross_matrix(rotation @ offset) @ twist[3:], by_point, atol=1e-12)
