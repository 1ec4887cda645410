import pytest
from pydantic import ValidationError

from im_core.config import FieldError
from im_core.errors import ConfigError, NotFoundError
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
        (
            "{name: left_track, driver: testbed, channel: 0}",
            "{name: left_trak, driver: testbed, channel: 0}",
            r"mcs.yaml:\d+: slots\[0\].name: 'left_trak' is not a joint of the cell \(did you mean 'left_track'",
        ),
        (
            "{name: left_rotation, driver: testbed, channel: 1}\n  - {name: left_tilt, driver: testbed, channel: 2}",
            "{name: left_tilt, driver: testbed, channel: 1}\n  - {name: left_rotation, driver: testbed, channel: 2}",
            r"mcs.yaml:\d+: slots\[1\].name: where left_rotation is expected is the slot of left_tilt; ",
        ),
        (
            "  - {name: right_j6, driver: testbed, channel: 17}\n",
            "",
            r"mcs.yaml:\d+: slots: joint right_j6 of the cell has no slot",
        ),
        (
            "{name: right_gripper, kind",
            "{name: right_griper, kind",
            r"mcs.yaml:\d+: slots\[19\].name: 'right_griper' is not a gripper of the cell \(did you mean 'right_g",
        ),
        (
            "wrist: left_wrist",
            "wrist: left_wirst",
            r"mcs.yaml:\d+: presets.2x9.left.wrist: there is no frame 'left_wirst' \(did you mean 'left_wrist'",
        ),
        (
            "law_processes: ",
            "group_control:\n  lift: {controller: 'im_mcs.control.pid:Pid'}\nlaw_processes: ",
            r"mcs.yaml:\d+: group_control.lift: there is no group 'lift' \(did you mean 'left'",
        ),
        (
            "pair: im_mcs.control.computed_torque:ComputedTorque",
            "pair: im_mcs.control.computed:Torque",
            r"mcs.yaml:\d+: switching.pair: 'im_mcs.control.computed:Torque' is none of switching.laws: im_mcs.c",
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


def test_a_preset_without_groups_is_refused(config, cell):
    with pytest.raises(FieldError, match="the preset has no groups; at least 1 is needed"):
        config.model_copy(update={"presets": {**config.presets, "none": {}}}).of_cell(cell)


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
