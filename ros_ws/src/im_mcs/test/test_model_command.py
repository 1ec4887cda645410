"""``model`` on the command line; its numbers are compared in test_model_reference."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from im_mcs.model.command import main

READY = "[0, 0.7853981633974483, 3.141592653589793, 0, 0.7853981633974483, 0]"


@pytest.fixture
def run(capsys):
    def run(*arguments):
        code = main(arguments)
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.mark.parametrize(("group", "joints", "poses"), [("left", 9, 1), ("transporter", 6, 2), ("testbed", 18, 2)])
def test_groups_with_carts_are_in_the_world(run, model, cell, group, joints, poses):
    code, out, err = run("--group", group, "--json")
    said = json.loads(out)
    assert (code, err) == (0, "")
    assert said["base_frame"] == "world"
    assert len(said["gravity_torques"]) == joints
    assert np.shape(said["inertia"]) == (joints, joints)
    shown = said["forward_kinematics"] if poses == 2 else {"left_wrist": said["forward_kinematics"]}
    for frame, pose in shown.items():
        np.testing.assert_allclose(pose, model.pose(cell.home, frame).homogeneous, atol=1e-12)
    index = [model.index(joint) for joint in said["joints"]]
    np.testing.assert_allclose(said["inertia_with_motor"], model.inertia(cell.home)[np.ix_(index, index)])


def test_a_preset_says_which_group_is_meant(run):
    assert len(json.loads(run("--group", "left", "--preset", "3x6", "--json")[1])["joints"]) == 6
    code, _, err = run("--group", "transporter", "--preset", "2x9")
    assert code == 2
    assert "no group 'transporter'" in err


def test_estimates_are_called_so(run):
    assert "right: puma_600: estimate" in run("--group", "right_arm")[1]
    assert "left: puma_560: P.I. Corke" in run("--group", "left_arm")[1]
    assert "left: cart: estimate" in run("--group", "left")[1]


def test_tables_have_units_and_all_numbers(run):
    out = run("--q", READY)[1]
    for word in ("left_j2", "31.639880 Nm", "rad", "pose of left_wrist in left_base [m]", "kg m2", "3.659375"):
        assert word in out
    assert "-0.000000" not in out


def test_beyond_the_end_stops_is_computed_with_a_warning(run):
    code, out, err = run("--q", "[0, 0.785, 3.14, 0, 0.785, 0]", "--json")
    assert code == 0
    assert "warning: left_j3: position 3.14 rad is beyond the limit 0.785398 rad" in err
    assert json.loads(out)["warnings"] == ["left_j3: position 3.14 rad is beyond the limit 0.785398 rad"]


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--group", "left_amr"], "no group 'left_amr'; did you mean 'left_arm'"),
        (["--preset", "4x4"], "no preset '4x4'"),
        (["--q", "[0, 0, 0]"], "q has 3 numbers; left_arm has 6 joints: left_j1"),
        (["--q", "[0, NaN, 0, 0, 0, 0]"], "left_j2: position nan is not a finite number"),
        (["--q", "[0, 0, 1e999, 0, 0, 0]"], "left_j3: position inf is not a finite number"),
        (["--q", "[0, 0, true, 0, 0, 0]"], "not a list of numbers"),
        (["--q", "0 0 0 0 0 0"], "q is '0 0 0 0 0 0', not a list of numbers"),
        (["--q", ""], "q is '', not a list of numbers"),
    ],
)
def test_what_is_wrong_is_named(run, arguments, sentence):
    code, out, err = run(*arguments)
    assert (code, out) == (2, "")
    assert sentence in err
    assert err.startswith("model: ")


@settings(max_examples=12, deadline=None)
@given(st.text(max_size=40) | st.recursive(st.none() | st.floats() | st.integers(), st.lists).map(json.dumps))
def test_any_text_is_computed_or_refused(text):
    assert main([f"--q={text}", "--json"]) in (0, 2)


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    for word in ("<group>_arm", "gravity_torques", "inertia_with_motor", "example:", "upright"):
        assert word in out
