"""YAML into models: faults name file, line and field."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import Field

from im_core.config import Model, load_model, package_file, parse_model
from im_core.errors import ConfigError


class Limits(Model):
    velocity: float = Field(gt=0.0)


class Slot(Model):
    name: str
    limits: Limits


class Config(Model):
    period: float
    slots: tuple[Slot, ...] = Field(min_length=1)


GOOD = """\
period: 0.0045
slots:
  - name: left_j1
    limits:
      velocity: 1.5
"""


def test_a_good_file_becomes_a_frozen_model(tmp_path: Path) -> None:
    path = tmp_path / "mcs.yaml"
    path.write_text(GOOD)
    config = load_model(path, Config)
    assert config.slots[0].limits.velocity == 1.5
    with pytest.raises(ValueError, match="frozen"):
        config.period = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("velocity: 1.5", "velocity: -1"), r"mcs\.yaml:5: slots\[0\]\.limits\.velocity: -1: .*greater than 0$"),
        (("velocity: 1.5", "velocity: true"), r"mcs\.yaml:5: slots\[0\]\.limits\.velocity: true: a number is needed$"),
        (("velocity: 1.5", "velocity: .inf"), r"mcs\.yaml:5: slots\[0\]\.limits\.velocity"),
        (("velocity: 1.5", "speed: 1.5"), r"mcs\.yaml:5: slots\[0\]\.limits\.(speed|velocity)"),
        ((GOOD[GOOD.index("slots") :], "slots: []"), r"^mcs\.yaml:2: slots: .*at least 1 item .*not 0$"),
        (("period: 0.0045\n", ""), r"mcs\.yaml:1: period: .*required"),
        (("period: 0.0045", "period: [0.0045"), r"mcs\.yaml:\d+: not YAML"),
        ((GOOD, ""), r"mcs\.yaml:1: the file is empty"),
        ((GOOD, "12"), r"^mcs\.yaml:1: 12: a mapping \(key: value\) is needed$"),
    ],
)
def test_faults_name_file_line_and_field(change: tuple[str, str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        parse_model(GOOD.replace(*change), Config, "mcs.yaml")


@given(st.text(max_size=80))
def test_any_text_is_either_a_model_or_a_config_error(text: str) -> None:
    try:
        parse_model(text, Config, "any.yaml")
    except ConfigError as error:
        named = error.message
    else:
        named = "any.yaml:"
    assert named.startswith("any.yaml:")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere\.yaml: cannot be read"):
        load_model(tmp_path / "nowhere.yaml", Config)
    with pytest.raises(ConfigError, match=r"package im_core ships no file 'nowhere\.yaml'"):
        package_file("im_core", "nowhere.yaml")
