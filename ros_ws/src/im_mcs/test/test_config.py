import pytest
from pydantic import ValidationError

from im_core.errors import ConfigError, NotFoundError
from im_mcs.client.kinematics import Kinematics
from im_mcs.limits.configuration import McsConfig, load_config
from im_mcs.limits.limits import JointLimits
from support.mcs_config import mcs_text


@pytest.fixture
def broken(tmp_path):
    text = mcs_text()

    def write(old, new):
        assert old in text
        path = tmp_path / "mcs.yaml"
        path.write_text(text.replace(old, new, 1))
        return path

    return write


def test_presets_partition_all_joints(config, cell):
    for preset in ("2x9", "3x6", "1x18"):
        joints = [joint for group in config.with_preset(preset).groups.values() for joint in group.joints]
        assert sorted(joints) == sorted(cell.joint_names)
    assert config.preset == "2x9"
    assert tuple(slot.name for slot in config.joint_slots) == cell.joint_names
    assert config.servo.period_s == cell.period


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda slots: slots[:6], "joint slot 7 is None, and joint 7 of the cell is left_j4"),
        (
            lambda slots: [slots[1], slots[0], *slots[2:]],
            "joint slot 1 is left_rotation, and joint 1 of the cell is left_t",
        ),
        (
            lambda slots: [slots[0].model_copy(update={"name": "shoulder_pan_joint"}), *slots[1:]],
            "joint slot 1 is shoulder_pan_joint, and joint 1 of the cell is left_track; joint slots have the names",
        ),
    ],
)
def test_slots_of_another_cell_are_refused(config, cell, change, message):
    with pytest.raises(ConfigError, match=message):
        JointLimits(cell, config.limits, change(list(config.slots)))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("velocity: 0.95", "velocity: -1", r"mcs.yaml:\d+: limits.velocity: -1: .*greater than 0"),
        ("preset: 2x9", "preset: 9x2", r"mcs.yaml:4: preset: preset '9x2' is not one of 1x18, 2x9, 3x6"),
        (
            "joints: [left_track,",
            "joints: [left_trak,",
            r"mcs.yaml:\d+: presets.2x9.left.joints\[0\]: 'left_trak' is not a joint slot",
        ),
        (
            "joints: [left_track, left_rotation",
            "joints: [left_track, left_track",
            r"mcs.yaml:\d+: presets.2x9.left.joints\[1\]: 'left_track' is already in group 'left'",
        ),
        (
            "joints: [left_track, left_rotation",
            "joints: [right_track, left_rotation",
            r"mcs.yaml:\d+: presets.2x9.right.joints\[0\]: 'right_track' is already in group 'left'",
        ),
        ("period_s: 0.0045", "periods: 0.0045", "servo.period_s"),
        (
            "{name: left_j1, driver: testbed, channel: 3}",
            "{name: left_track, driver: testbed, channel: 3}",
            r"mcs.yaml:\d+: slots\[3\].name: two slots have the same name, 'left_track'",
        ),
    ],
)
def test_mistakes_are_named_with_file_and_line(broken, old, new, message):
    with pytest.raises(ConfigError, match=message):
        load_config(broken(old, new))


def test_limits_that_leave_a_joint_no_position_are_refused(config, cell):
    wide = config.limits.model_copy(update={"position_margin": 5.0})
    with pytest.raises(ConfigError, match=r"the limits of left_\w+ leave it no position: .* margin included"):
        JointLimits(cell, wide, config.slots)


def test_a_wrist_that_is_no_frame_is_refused(config, model):
    left = config.groups["left"].model_copy(update={"wrist": "left_wirst"})
    presets = {**config.presets, "3x6": {"left": left}}
    with pytest.raises(ConfigError, match=r"presets.3x6.left.wrist: there is no frame 'left_wirst'"):
        Kinematics(config.model_copy(update={"presets": presets}), model)
    with pytest.raises(ValueError, match="the preset has no groups; at least 1 is needed"):
        McsConfig.model_validate({**config.model_dump(), "presets": {**config.model_dump()["presets"], "none": {}}})


def test_unknown_preset(config):
    with pytest.raises(NotFoundError, match="there is no preset '2x8'; did you mean '2x9'"):
        config.with_preset("2x8")


def test_another_period_keeps_the_durations(config, cell):
    """Physics steps stay as long as they were, as near as whole numbers allow."""
    fast, servo = config.at_period(0.001), config.servo
    assert fast.servo.period_s == 0.001
    for name in ("rest_window_ticks", "brake_lead_ticks", "planning_divisor"):
        assert getattr(fast.servo, name) * 0.001 == pytest.approx(getattr(servo, name) * servo.period_s, abs=5e-4)
    assert fast.servo.settle.window_ticks == 72
    assert fast.collision.reaction_ticks == 18  # two evaluations of a trajectory, as before
    assert config.at_period(servo.period_s) == config
    assert (cell.at_period(0.001).period, cell.at_period(0.001).substeps) == (0.001, 1)
    assert cell.at_period(cell.period) == cell


@pytest.mark.parametrize(
    ("period", "words"), [(0.0, "is not > 0"), (float("nan"), "is not > 0"), (0.2, "period of 0.2 s")]
)
def test_a_period_that_cannot_be_is_refused(config, period, words):
    with pytest.raises(ConfigError, match=words):
        config.at_period(period)


def test_a_law_process_of_a_law_that_is_not_there_is_refused(config):
    with pytest.raises(ValidationError, match="'my:Law' is none of the control laws"):
        McsConfig.model_validate({**config.model_dump(), "law_processes": {"laws": ["my:Law"]}})
