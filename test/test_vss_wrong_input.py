"""Wrong requests of every vision Service: each refused with a sentence, nothing changed, every Module free."""

import copy
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.calibration.synthetic import Design, make_scene
from im_core import plugins
from im_core.errors import ImError
from im_msgs.srv import (
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
)
from im_vss.ros.ports import Port

CEILING = ["ceiling_left", "ceiling_right"]
KNOWN = [*CEILING, "wall", "table", "wrist_left"]
NOT_A_LENGTH = st.floats(max_value=0.0) | st.sampled_from([math.nan, math.inf])
NOT_FINITE = st.sampled_from([math.nan, math.inf, -math.inf])
TEXT = st.text(min_size=1, max_size=30).filter(lambda name: "\0" not in name)
UNKNOWN = st.text(max_size=30).filter(lambda name: name not in KNOWN and "\0" not in name)
EXPOSURE = st.floats().filter(lambda s: s != 0.0 and not 0.0045 <= s <= 0.45)
SOME = st.sampled_from([[], ["wall", "wall"]]) | st.lists(UNKNOWN, min_size=1, max_size=3)
TWO = SOME | st.sampled_from([["wall"], ["wall", "table", "ceiling_left"], ["wall", "wrist_left"]])
ANGLE = st.floats().filter(lambda angle: not abs(angle) <= 0.22)
ANGLES = st.tuples(ANGLE, st.floats(-0.2, 0.2)).flatmap(st.permutations).map(list)
REGION = st.tuples(*[st.integers(0, 2**32 - 1)] * 2, *[st.integers(1, 2**32 - 1)] * 2).filter(
    lambda r: r[0] + r[2] > 640 or r[1] + r[3] > 480 or min(r[2:]) < 16
)


def set_region(message, values):
    for field, value in zip(("x_offset", "y_offset", "width", "height"), values, strict=True):
        setattr(message.region, field, value)


def set_target(message, values):
    message.to_target = True
    message.target.x, message.target.y, message.target.z = values


#: For each Service: a request that is right, and what is wrong for each of its fields (or how a value is put in).
WRONG = {
    "snap": (Snap, {"cameras": ["wall"]}, {"cameras": SOME, "exposure": EXPOSURE}),
    "spot_find": (SpotFind, {"cameras": ["wall"]}, {"cameras": SOME, "exposure": EXPOSURE, "look": TEXT}),
    "spot_look": (SpotLook, {"cameras": ["wall"]}, {"cameras": SOME, "exposure": EXPOSURE}),
    "spot_find_stereo": (SpotFindStereo, {"cameras": CEILING}, {"cameras": TWO, "exposure": EXPOSURE}),
    "circle_find": (
        CircleFind,
        {"camera": "wall"},
        {
            "camera": UNKNOWN,
            "exposure": EXPOSURE,
            "radius_min": st.floats().filter(lambda r: r != 0.0 and not 3.0 <= r <= 80.0),
            "radius_max": st.floats(max_value=4.9).filter(bool) | NOT_FINITE,
            set_region: REGION,
        },
    ),
    "line_find": (
        LineFind,
        {"camera": "wall"},
        {
            "camera": UNKNOWN,
            "exposure": EXPOSURE,
            "length_min": st.floats(max_value=11.9).filter(bool) | NOT_FINITE,
            set_region: REGION,
        },
    ),
    "fiducial_pose": (
        FiducialPose,
        {"cameras": ["wall"]},
        {
            "cameras": SOME,
            "exposure": EXPOSURE,
            "ids": st.lists(st.integers(100, 2**31 - 1) | st.integers(-(2**31), -1), min_size=1, max_size=3),
        },
    ),
    "laser_point": (
        LaserPoint,
        {"angles": [0.1, 0.1]},
        {
            "angles": ANGLES,
            set_target: st.tuples(NOT_FINITE, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0)).flatmap(st.permutations)
            | st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(4.5, 1e6)),
        },
    ),
    "laser_spot_3d": (
        LaserSpot3d,
        {"cameras": CEILING},
        {"cameras": TWO, "exposure": EXPOSURE, "angles": ANGLES},
    ),
    "line_scan": (
        LineScan,
        {"cameras": CEILING, "span": [0.0, 0.1], "sweep": [-0.1, 0.1], "lines": 3},
        {
            "cameras": SOME,
            "exposure": EXPOSURE,
            "span": st.tuples(st.floats(-0.2, 0.2), st.floats(0.0, 0.2)).map(lambda s: [s[0], s[0] - s[1]])
            | ANGLE.map(lambda a: [-0.1, a])
            | ANGLE.map(lambda a: [a, 0.1]),
            "sweep": ANGLES,
            "lines": st.just(0) | st.integers(201, 2**32 - 1),
        },
    ),
    "laser_calibrate": (
        LaserCalibrate,
        {"cameras": CEILING, "mirror1": [0.1, 0.0], "mirror2": [0.05, 0.0]},
        {
            "cameras": TWO,
            "mirror1": st.lists(ANGLE, min_size=2, max_size=2) | st.sampled_from([[], [0.1], [0.0] * 3]),
            "mirror2": st.lists(ANGLE, min_size=2, max_size=2) | st.sampled_from([[], [0.1], [0.0] * 3]),
        },
    ),
}

#: What may be wrong in an observation or in a known length.
SPOILT_SPOT = st.sampled_from(
    [
        lambda spot: setattr(spot, "u", math.nan),
        lambda spot: setattr(spot, "v", -math.inf),
        lambda spot: setattr(spot, "camera", "sealing"),
        lambda spot: setattr(spot, "covariance", [0.0] * 4),
        lambda spot: setattr(spot, "covariance", [1.0, 0.5, -0.5, 1.0]),
        lambda spot: setattr(spot, "covariance", [1.0, 0.0, 0.0, math.nan]),
        lambda spot: setattr(spot, "covariance", [-1.0, 0.0, 0.0, 1.0]),
    ]
)
SPOILT_OBSERVATION = st.sampled_from(
    [
        lambda o: setattr(o.wrist.position, "x", math.nan),
        lambda o: setattr(o.wrist.position, "z", math.inf),
        lambda o: setattr(o.wrist.orientation, "w", math.nan),
        lambda o: setattr(o.wrist.orientation, "w", o.wrist.orientation.w + 2.5),
        lambda o: setattr(o, "position_covariance", [math.nan] * 9),
        lambda o: setattr(o, "position_covariance", [-1e-8, *o.position_covariance[1:]]),
        lambda o: setattr(o, "position_covariance", [1.0, 0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]),
        lambda o: o.spots.append(o.spots[0]),
    ]
)
FUZZ = settings(deadline=None, max_examples=40, suppress_health_check=list(HealthCheck))


@pytest.fixture(scope="module")
def refused(machine):
    """``refused(service, message)``: the Service refuses it, leaves everything as it was, and every Module free."""
    machine.calibrate_cameras(*CEILING, "wall", "table")
    vsm, rig = machine.vss._vsm, machine.vss._rig
    catalogue = vsm.catalogue.services

    def state():
        leases = {name: (module.owner, module.queue) for name, (_, module) in vsm.state().modules.items()}
        laser = rig.laser.scanner.reading()
        return leases, vsm.state().requests, rig.book.entries(), rig.laser.book.entry, laser, machine.testbed._link.tick

    def check(service, message):
        before = state()
        assert set(before[0].values()) == {("", ())}
        port = plugins.load(catalogue[service].port, Port, "port")(rig)
        with pytest.raises(ImError) as caught:
            vsm.request(service, port.request(message))
        assert len(caught.value.message) > 15
        assert caught.value.code in ("config", "data", "limit", "look_forgotten", "not_found", "state", "unobservable")
        after = state()
        assert all(a is b for a, b in zip(before[2], after[2], strict=True))
        assert (after[:2], after[3:]) == (before[:2], before[3:])

    return check


def test_every_service_is_here(machine):
    assert {*WRONG, "calibrate"} == set(machine.vss._vsm.services)


@pytest.mark.parametrize("service", WRONG)
@FUZZ
@given(data=st.data())
def test_a_wrong_field_is_refused(refused, service, data):
    kind, right, wrong = WRONG[service]
    field = data.draw(st.sampled_from(list(wrong)))
    value, message = data.draw(wrong[field]), kind.Request(**right)
    if callable(field):
        field(message, value)
    else:
        setattr(message, field, value)
    refused(service, message)


@pytest.fixture(scope="module")
def calibrate(calibration_request):
    """A right request of ``calibrate``."""
    from im_msgs.srv import Calibrate

    return Calibrate.Request(**calibration_request(make_scene(Design(poses=12, lengths=3), 2).problem), apply=True)


@FUZZ
@given(data=st.data())
def test_a_wrong_observation_or_length_is_refused(refused, calibrate, data):
    message = copy.deepcopy(calibrate)
    part = data.draw(st.sampled_from(["observation", "spot", "length", "end", "cameras", "none"]))
    if part == "cameras":
        message.cameras = data.draw(SOME)
    elif part == "none":
        message.observations = []
    elif part == "observation":
        data.draw(SPOILT_OBSERVATION)(data.draw(st.sampled_from(message.observations)))
    elif part == "length":
        field = data.draw(st.sampled_from(["length", "sd"]))
        value = data.draw(NOT_A_LENGTH if field == "length" else NOT_A_LENGTH.filter(bool))
        setattr(data.draw(st.sampled_from(message.known_lengths)), field, value)
    else:
        places = message.observations if part == "spot" else message.known_lengths
        place = data.draw(st.sampled_from(places))
        spots = place.spots if part == "spot" else data.draw(st.sampled_from([place.first, place.second]))
        found = [spot for spot in spots if spot.found]
        if not found:
            return
        data.draw(SPOILT_SPOT)(found[0])
    refused("calibrate", message)


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"cameras": ["ceiling_lift"]}, "there is no camera 'ceiling_lift'; did you mean 'ceiling_left'? (known: ceil"),
        ({"cameras": []}, "no camera is given (known: ceiling_left"),
        ({"cameras": ["wall", "wall"]}, "a camera is given twice: wall, wall"),
        ({"cameras": ["wall"], "exposure": 3.0}, "an exposure of 3 s is not between 0.0045 and 0.45 s"),
        ({"cameras": ["wall"], "exposure": float("nan")}, "an exposure of nan s is not between"),
    ],
)
def test_wrong_requests_are_one_sentence(machine, fields, sentence):
    answer = machine.call(SpotFind, "/vss/spot_find", **fields)
    assert not answer.success
    assert sentence in answer.status.message
    assert np.all([module.owner == "" for _, module in machine.vss._vsm.state().modules.values()])
