"""The expected duration of a command beside the measured one."""

import pytest

from im_core.config import package_file
from im_dispatcher.expectation import beside, expectation
from im_dispatcher.report import StepTimes
from im_pnt.model.net import Net
from im_pnt.netfile import load_net, parse_net

LOOP = """
net: calibrate_camera
places: {idle: 1, ready: , moved: , lost: }
transitions:
  begin: {in: idle, out: ready, symbol: calibrate_camera}
  move: {in: ready, out: moved, action: move, delay: 2.0, on_failure: lost}
  skip_again: {in: moved, out: ready, guard: more, weight: 5}
  loop_done: {in: moved, out: idle, guard: not more, emit: calibrate_camera_done}
  give_up: {in: lost, out: idle, emit: calibrate_camera_failed}
"""


@pytest.mark.parametrize("poses", [1, 12, 40])
def test_the_expectation_grows_with_the_poses(poses: int) -> None:
    expected = expectation([parse_net(LOOP)], "calibrate_camera", poses)
    assert expected.mean == pytest.approx(2.0 * poses, rel=0.35 if expected.half_width else 1e-6)
    assert expected.bottleneck.transition.endswith("move")


def test_the_measured_run_stands_beside_it() -> None:
    times = StepTimes()
    for begin in (0.0, 3.0):
        times.note_start("calibrate_camera.move", 0, begin)
        times.note_end("calibrate_camera.move", 0, begin + 2.5, 0.1)
    told = beside(expectation([parse_net(LOOP)], "calibrate_camera", 2), times.steps, 5.5)
    assert told["measured_s"] == 5.5
    assert told["bottleneck"] in ("move", "calibrate_camera.move")
    steps = told["steps"]
    assert isinstance(steps, dict)
    move = steps["calibrate_camera.move"]
    assert (move["expected_s"], move["measured_s"], move["measured_count"]) == (2.0, 2.5, 2)


def test_the_shipped_nets_say_how_long_things_take() -> None:
    nets: list[Net] = [load_net(package_file("im_dispatcher", "nets/calibrate_camera.yaml"))]
    nets += [
        load_net(package_file("im_coordinators", f"nets/{name}_coordinator.yaml"))
        for name in ("motion", "vision", "path_planning")
    ]
    expected = expectation(nets, "calibrate_camera", 20)
    assert expected.bottleneck.transition == "motion_coordinator.move_manip"
    assert expected.done > 0.5
