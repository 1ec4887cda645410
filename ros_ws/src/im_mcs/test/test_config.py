import pytest

from im_core.config import package_file
from im_core.errors import ConfigError, NotFoundError
from im_mcs.config import load_config


@pytest.fixture
def broken(tmp_path):
    text = package_file("im_mcs", "config/mcs.yaml").read_text()

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
        ("preset: 2x9", "preset: 9x2", "preset '9x2' is not one of 1x18, 2x9, 3x6"),
        ("joints: [left_track,", "joints: [left_trak,", "'left_trak', which is no joint slot"),
        ("period_s: 0.0045", "periods: 0.0045", "servo.period_s"),
        ("{name: left_j1, channel: 3}", "{name: left_track, channel: 3}", "two slots have the same name"),
    ],
)
def test_mistakes_are_named_with_file_and_line(broken, old, new, message):
    with pytest.raises(ConfigError, match=message):
        load_config(broken(old, new))


def test_unknown_preset(config):
    with pytest.raises(NotFoundError, match="there is no preset '2x8'; did you mean '2x9'"):
        config.with_preset("2x8")
