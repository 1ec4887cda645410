"""Services of ``/vss`` beyond the spot: stereo, circles, lines, fiducials; controls, state, cancelling."""

import numpy as np
import pytest
from geometry_msgs.msg import TransformStamped
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image, RegionOfInterest
from tf2_msgs.msg import TFMessage

from im_cell.robot import load_cell
from im_core import clock
from im_core.ros import qos
from im_msgs.msg import VisionState
from im_msgs.srv import Advance, CircleFind, FiducialPose, LineFind, Snap, SpotFindStereo, VisionCancel, VisionQuery
from im_vss.edges.step import undistorted
from im_vss.managers import VisionClient

CEILING = ["ceiling_left", "ceiling_right"]
CELL = load_cell()
TOPICS = [(Image, "image_raw"), (CameraInfo, "camera_info")]


@pytest.fixture(scope="module")
def calibrated(machine):
    """The machine, its ceiling cameras and the wall's calibrated as they truly are."""
    machine.calibrate_cameras(*CEILING, "wall")
    return machine


def set_parameters(machine, **values):
    message = [Parameter(name.replace("__", "."), value=value).to_parameter_msg() for name, value in values.items()]
    return machine.call(SetParameters, "/vss/set_parameters", parameters=message).results


def test_no_point_from_cameras_as_drawn(machine):
    """First in this module: the cameras are still as the drawing has them."""
    machine.light(on=True)
    answer = machine.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    assert answer.success, answer.status.message
    assert not answer.found
    assert answer.cause == "no point from cameras that are not calibrated: ceiling_left, ceiling_right"
    assert answer.epipolar_distance > 1.0
    assert all(spot.found for spot in answer.spots)
    poses = machine.call(FiducialPose, "/vss/fiducial_pose", cameras=CEILING[:1])
    assert (poses.success, poses.fiducials) == (True, [])
    assert "no pose from ceiling_left: its lens is not calibrated" in poses.cause
    lines = machine.call(LineFind, "/vss/line_find", camera="ceiling_left")
    assert (lines.success, lines.status.code, bool(lines.lines)) == (True, "ok", True)
    assert "the lens of ceiling_left is not calibrated: it is taken as drawn" in lines.status.message


def test_stereo_point_is_within_its_covariance(calibrated):
    calibrated.light(on=True)
    answer = calibrated.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)
    assert answer.found, answer.cause
    left, right = (calibrated.true_camera(name) for name in CEILING)
    point = np.array([answer.point.point.x, answer.point.point.y, answer.point.point.z])
    covariance = np.array(answer.covariance).reshape(3, 3)
    for spot, camera in zip(answer.spots, (left, right), strict=True):
        assert np.linalg.norm(camera.project(point) - (spot.u, spot.v)) < 0.25
    assert answer.epipolar_distance < 0.3
    error = point - calibrated.light_at_home()
    assert error @ np.linalg.solve(covariance, error) < 25.0
    assert 1e-5 < np.sqrt(covariance[2, 2]) < 2e-3
    assert [len(each.candidates) for each in answer.candidates] == [1, 1]
    assert not any(each.predicted for each in answer.candidates)  # no robot is running
    wrong = calibrated.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=["wall", "wrist_left"])
    assert "wrist_left moves with left_wrist: stereo needs fixed cameras" in wrong.status.message
    wrong = calibrated.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=["wall"])
    assert "stereo needs two cameras, got 1: wall" in wrong.status.message


def test_the_robot_says_where_to_look(calibrated):
    """Where the pose on /tf puts the light, it is found; elsewhere it is not looked for."""
    calibrated.light(on=True)
    tf = calibrated.client.create_publisher(TFMessage, "/tf", qos.EVENTS)
    calibrated.until(lambda: tf.get_subscription_count() > 0)
    offset = np.array(CELL.led.offset)

    def look(shift):
        place = calibrated.light_at_home() - offset + shift
        before = calibrated.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING).spots[0].stamp
        link = TransformStamped(child_frame_id="left_link6")
        link.header.frame_id, link.header.stamp = "world", before
        link.transform.translation.x, link.transform.translation.y, link.transform.translation.z = place
        tf.publish(TFMessage(transforms=[link]))
        return calibrated.call(SpotFindStereo, "/vss/spot_find_stereo", cameras=CEILING)

    def looked(shift, heard):
        """The first answer that shows that the pose was heard."""
        answers = []
        calibrated.until(lambda: answers.append(look(shift)) or heard(answers[-1]))
        return answers[-1]

    answer = looked(np.zeros(3), lambda answer: any(each.predicted for each in answer.candidates))
    assert answer.found, answer.cause
    for name, each in zip(CEILING, answer.candidates, strict=True):
        assert each.predicted
        assert each.radius == 15.0
        assert np.hypot(*(calibrated.true_camera(name).project(calibrated.light_at_home()) - (each.u, each.v))) < 1.0
    elsewhere = looked(np.array([0.3, 0.0, 0.0]), lambda answer: not answer.found)
    assert "searched within 15 px of" in elsewhere.cause


def test_fiducial_is_where_it_truly_is(calibrated):
    answer = calibrated.call(FiducialPose, "/vss/fiducial_pose", cameras=CEILING)
    assert answer.success, answer.status.message
    assert [(f.camera, f.name) for f in answer.fiducials] == [(name, "table_tag") for name in CEILING]
    assert answer.cause.count("board_tag in ceiling_") == 2
    rotation, place = next(target for target in CELL.targets if target.name == "table_tag").pose()
    for fiducial in answer.fiducials:
        camera = calibrated.true_camera(fiducial.camera)
        pose, q = fiducial.pose.pose.pose, fiducial.pose.pose.pose.orientation
        assert fiducial.pose.header.frame_id == f"{fiducial.camera}_optical_frame"
        seen = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        turn = Rotation.from_matrix(seen @ (camera.R_cam_base @ rotation).T).as_rotvec()
        shift = np.array([pose.position.x, pose.position.y, pose.position.z]) - camera.to_camera(place)
        error, covariance = np.concatenate((shift, turn)), np.array(fiducial.pose.pose.covariance).reshape(6, 6)
        assert error @ np.linalg.solve(covariance, error) < 30.0
    wrong = calibrated.call(FiducialPose, "/vss/fiducial_pose", cameras=CEILING, ids=[3])
    assert "there is no fiducial '3'" in wrong.status.message


def test_circle_and_line_are_where_they_truly_are(calibrated):
    targets, camera = {target.name: target for target in CELL.targets}, calibrated.true_camera("ceiling_left")
    u, v = camera.project(targets["table_disc"].position)
    region = RegionOfInterest(x_offset=int(u) - 40, y_offset=int(v) - 40, width=80, height=80)
    answer = calibrated.call(CircleFind, "/vss/circle_find", camera="ceiling_left", region=region)
    (circle,) = answer.circles
    error, covariance = np.array([circle.u - u, circle.v - v]), np.array(circle.covariance).reshape(2, 2)
    assert (
        error @ np.linalg.solve(covariance + 0.05**2 * np.eye(2), error) < 20.0
    )  # a disc's centre is not its ellipse's
    assert circle.dark
    assert circle.coverage == 1.0
    rotation, centre = targets["table_edge"].pose()
    start, end = undistorted(camera, camera.project(centre + np.array([[0, -0.17, 0], [0, 0.17, 0]]) @ rotation.T))
    along = (end - start) / np.linalg.norm(end - start)
    answer = calibrated.call(LineFind, "/vss/line_find", camera="ceiling_left")
    middles = [(np.array(line.start) + np.array(line.end)) / 2.0 for line in answer.lines]
    near = [
        (line, m) for line, m in zip(answer.lines, middles, strict=True) if np.linalg.norm(m - (start + end) / 2) < 15
    ]
    (line, middle) = min(near, key=lambda pair: -pair[0].contrast)
    across = (middle - start) @ [-along[1], along[0]]
    assert abs(across) < 5.0 * np.sqrt(line.covariance[0])
    wrong = calibrated.call(CircleFind, "/vss/circle_find", camera="wall", radius_min=50.0, radius_max=20.0)
    assert "radii from 50 to 20 px" in wrong.status.message
    far = RegionOfInterest(x_offset=600, y_offset=0, width=80, height=80)
    wrong = calibrated.call(LineFind, "/vss/line_find", camera="wall", region=far)
    assert "a region of 80 x 80 px at (600, 0) px is not in the image of 640 x 480 px" in wrong.status.message


def test_controls_are_parameters_with_ranges(machine):
    names = ["exposure", "wall.gain", "wall.noise", "wall.rate"]
    described = machine.call(DescribeParameters, "/vss/describe_parameters", names=names).descriptors
    spans = [each.floating_point_range[0] for each in described]
    assert [(span.from_value, span.to_value) for span in spans] == [
        (0.0045, 0.45),
        (0.25, 8.0),
        (0.0, 10.0),
        (0.0, 10.0),
    ]

    def image():
        return np.frombuffer(machine.call(Snap, "/vss/snap", cameras=["wall"]).images[0].data, np.uint8).astype(float)

    before = image()
    assert all(result.successful for result in set_parameters(machine, wall__gain=2.0, wall__noise=0.0))
    bright = image()
    assert bright.mean() - 8.0 == pytest.approx(2.0 * (before.mean() - 8.0), rel=0.03)
    assert all(result.successful for result in set_parameters(machine, wall__gain=1.0, wall__noise=1.0, exposure=0.009))
    assert image().mean() - 8.0 == pytest.approx(0.5 * (before.mean() - 8.0), rel=0.05)
    (refused,) = set_parameters(machine, wall__gain=9.0)
    assert not refused.successful
    assert set_parameters(machine, exposure=0.018)[0].successful


def listen(machine, camera, kind, topic):
    return machine.listen(kind, f"/{camera}/{topic}", qos.IMAGES)


def advance(machine, seconds):
    """Let testbed time pass, as if somebody wanted it."""
    assert machine.call(Advance, "/testbed/advance", duration=seconds).success


def test_images_flow_at_a_rate_of_testbed_time(machine):
    """At clock factor 0: whenever somebody wants a period of time there is an image, of both cameras at once."""
    seen = [listen(machine, name, *topic) for name in ("table", "wall") for topic in TOPICS]
    assert all(result.successful for result in set_parameters(machine, table__rate=5.0, wall__rate=5.0))
    for number in range(5):
        machine.until(lambda number=number: all(len(each) == number + 1 for each in seen))
        if number < 4:
            advance(machine, 0.2)
    for each in seen[1:]:
        assert [message.header.stamp for message in each] == [message.header.stamp for message in seen[0]]
    stamps = [image.header.stamp.sec + image.header.stamp.nanosec * 1e-9 for image in seen[0]]
    assert (np.diff(np.floor(np.array(stamps) / 0.2)) >= 1.0).all()
    assert all(result.successful for result in set_parameters(machine, table__rate=0.0, wall__rate=0.0))


def test_no_image_at_a_rate_is_left_out_however_fast_time_passes(machine):
    """At clock factor 0 ten periods that somebody wants at once take as long as their images."""
    seen = [listen(machine, name, *TOPICS[0]) for name in ("table", "wall")]
    assert all(result.successful for result in set_parameters(machine, table__rate=10.0, wall__rate=5.0))
    machine.until(lambda: all(seen))
    advance(machine, 2.0)
    machine.until(lambda: all(len(images) >= most for images, most in zip(seen, (19, 9), strict=True)))
    for images, period_s in zip(seen, (0.1, 0.2), strict=True):
        stamps = np.array([image.header.stamp.sec + image.header.stamp.nanosec * 1e-9 for image in images])
        assert (np.diff(np.floor(stamps[1:] / period_s)) == 1.0).all()  # the first comes at once, not at a multiple
    assert all(result.successful for result in set_parameters(machine, table__rate=0.0, wall__rate=0.0))


def test_images_at_a_rate_do_not_drive_the_clock_on(machine):
    """Exposures of four periods and more: what they take of testbed time brings no further image."""
    seen, began = [listen(machine, name, *TOPICS[0]) for name in ("table", "wall")], machine.testbed._link.tick
    assert all(result.successful for result in set_parameters(machine, exposure=0.45, table__rate=10.0, wall__rate=9.0))
    period = machine.testbed._link.period_s

    def fresh():  # an image of the test before may come late
        stamps = [[image.header.stamp.sec + image.header.stamp.nanosec * 1e-9 for image in each] for each in seen]
        return [sum(stamp > began * period for stamp in each) for each in stamps]

    machine.until(lambda: all(fresh()))
    clock.sleep(1.5)
    assert machine.testbed._link.tick - began <= 2 * (0.45 / period + 1)
    assert fresh() == [1, 1]
    advance(machine, 0.2)
    machine.until(lambda: sum(fresh()) > 2)
    controls = {"exposure": 0.018, "table__rate": 0.0, "wall__rate": 0.0}
    assert all(result.successful for result in set_parameters(machine, **controls))


def test_state_is_answered_and_latched_and_cancels(machine):
    state = machine.call(VisionQuery, "/vss/query").state
    assert set(state.services) == set(machine.vss._vsm.services)
    assert [module.name for module in state.modules] == [
        "vm_snap", "vm_image_disp", "vm_spot_disp", "vm_solver", "vm_laser",
    ]  # fmt: skip
    assert all(module.leases == module.released + module.lapsed for module in state.modules)
    answer = machine.call(VisionCancel, "/vss/cancel", request="snap #0")
    assert "there is no request under way 'snap #0'" in answer.status.message
    seen = machine.listen(VisionState, "/vss/state", qos.LATCHED)
    machine.until(lambda: seen)
    slow = machine.client.create_client(Snap, "/vss/snap")
    machine.until(slow.service_is_ready)
    vmm = machine.vss._vsm.managers["image_processing"]
    with vmm.lend("vm_snap", VisionClient("somebody")):
        futures = [slow.call_async(Snap.Request(cameras=["wall"])) for _ in range(4)]
        machine.until(lambda: len(seen[-1].modules[0].queue) == 4)
        assert (seen[-1].modules[0].owner, len(seen[-1].requests)) == ("somebody", 4)
        last = machine.call(VisionQuery, "/vss/query").state.modules[0].queue[-1]
        assert machine.call(VisionCancel, "/vss/cancel", request=last).success
        machine.until(lambda: any(future.done() for future in futures))
    machine.until(lambda: all(future.done() for future in futures))
    answers = [future.result() for future in futures]
    assert [answer.success for answer in answers].count(False) == 1
    (given_up,) = [answer.status for answer in answers if not answer.success]
    assert last in given_up.message
    machine.until(lambda: seen[-1].requests == [])
