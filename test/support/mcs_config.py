"""Configurations of MCS that differ from that of the package."""

from pathlib import Path

import yaml

from im_core.config import package_file


def mcs_text():
    """Return ``mcs.yaml`` with slots and presets of its own, those of the pair of PUMAs."""
    text = package_file("im_mcs", "config/mcs.yaml").read_text(encoding="utf-8")
    own = (Path(__file__).with_name("puma_slots.yaml")).read_text(encoding="utf-8")
    assert 'preset: ""' in text
    return text.replace('preset: ""', "preset: 2x9", 1) + own


def write_mcs_config(folder, **changes):
    """Write ``mcs.yaml`` with some values of its sections changed, e.g. ``servo={"max_overruns": 9}``; its path."""
    data = yaml.safe_load(package_file("im_mcs", "config/mcs.yaml").read_text(encoding="utf-8"))
    for section, values in changes.items():
        data[section] |= values
    path = folder / "mcs.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path
