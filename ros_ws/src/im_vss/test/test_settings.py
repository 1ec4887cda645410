"""Names in the settings that the cell does not know are told with file, line and field."""

import re

import pytest
import yaml

from im_cell.robot import load_cell
from im_core.config import package_file
from im_core.errors import ConfigError
from im_vss.settings import load_settings


@pytest.mark.parametrize(
    ("place", "sentence"),
    [
        (("cameras", 1), "cameras[1]: there is no camera 'wal'; did you mean 'wall'?"),
        (("stereo", "pairs", 0, 1), "stereo.pairs[0][1]: there is no camera of a stereo pair 'wal'"),
        (("light", "name"), "light.name: there is no light 'wal'"),
    ],
)
def test_unknown_names_are_told_with_their_place(tmp_path, place, sentence):
    content = yaml.safe_load(package_file("im_vss", "config/vss.yaml").read_text())
    content["cameras"], content["stereo"]["pairs"] = ["table", "wall"], [["table", "wall"]]
    inner = content
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = "wal"
    path = tmp_path / "vss.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(ConfigError, match=rf"vss\.yaml:\d+: {re.escape(sentence)}"):
        load_settings(load_cell(), path)
