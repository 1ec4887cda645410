"""Configurations of MCS that differ from that of the package."""

import yaml

from im_core.config import package_file


def write_mcs_config(folder, **changes):
    """Write ``mcs.yaml`` with some values of its sections changed, e.g. ``servo={"max_overruns": 9}``; its path."""
    data = yaml.safe_load(package_file("im_mcs", "config/mcs.yaml").read_text(encoding="utf-8"))
    for section, values in changes.items():
        data[section] |= values
    path = folder / "mcs.yaml"
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path
