"""What RViz and Foxglove are configured to show of a cell, against the topics and types of the machine."""

import json
import math
import re
from pathlib import Path

import pytest
import yaml

from im_cell.robot import load_cell, shipped_cells
from im_mcs.cell.command import main
from im_mcs.cell.views import foxglove_layout, rviz_config
from im_mcs.model import CellModel

PAGE = (Path(__file__).parents[4] / "docs" / "interfaces.md").read_text()
TOPICS = dict(re.findall(r"\| `(/\S+)` \| `(\S+)` \|", PAGE.partition("## Topics")[2]))
#: Types that displays of RViz and panels of Foxglove take.
RVIZ = {
    "RobotModel": "std_msgs/msg/String",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Image": "sensor_msgs/msg/Image",
}
LATCHED = ("/robot_description", "/markers")


@pytest.fixture(params=shipped_cells())
def cell(request):
    return load_cell(request.param)


def kind_of(topic, cell):
    """Type of a topic; those of a camera are those of a camera of the pair of PUMAs."""
    camera, _, rest = topic[1:].partition("/")
    return TOPICS[f"/ceiling_left/{rest}" if camera in cell.cameras else topic]


def test_rviz_shows_topics_of_the_machine_as_they_are_published(cell):
    manager = yaml.safe_load(rviz_config(cell))["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    shown = {}
    for display in manager["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            shown[topic["Value"]] = display["Class"].removeprefix("rviz_default_plugins/")
            latched = topic["Value"] in LATCHED
            assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
    assert {topic: kind_of(topic, cell) for topic in shown} == {topic: RVIZ[kind] for topic, kind in shown.items()}
    assert shown.keys() == {*LATCHED, *(f"/{camera}/image_raw" for camera in cell.cameras)}
    eye = manager["Views"]["Current"]
    for group in cell.groups.values():
        tip = CellModel(cell).pose(cell.home, group.tip).translation
        assert math.dist(tip, eye["Focal Point"].values()) < 0.6 * eye["Distance"]


def panels(layout):
    """Names of the panels in a layout, from first to last."""
    if isinstance(layout, str):
        return [layout]
    return [*panels(layout["first"]), *panels(layout["second"])]


def test_foxglove_shows_topics_of_the_machine(cell):
    told = json.loads(foxglove_layout(cell))
    config = told["configById"]
    assert panels(told["layout"]) == list(config)
    scene = config["3D!cell"]
    assert scene["layers"]["cell"]["topic"] in TOPICS
    assert {TOPICS[topic] for topic in scene["topics"]} == {"visualization_msgs/msg/MarkerArray"}
    images = [panel["imageMode"] for name, panel in config.items() if name.startswith("Image!")]
    assert len(images) == len(cell.cameras)
    for image in images:
        assert kind_of(image["imageTopic"], cell) == "sensor_msgs/msg/CompressedImage"
        assert kind_of(image["calibrationTopic"], cell) == "sensor_msgs/msg/CameraInfo"
    assert config["RawMessages!mcs"]["topicPath"] in TOPICS
    assert config["DiagnosticSummary!all"]["topicToRender"] in TOPICS


def test_a_command_writes_them_and_names_them(tmp_path, capsys):
    assert main(["export", "ur5", "--output", str(tmp_path / "views")]) == 0
    told = capsys.readouterr().out.split()
    assert told == [str(tmp_path / "views" / name) for name in (
        "cell.srdf", "joint_limits.yaml", "kinematics.yaml", "moveit_controllers.yaml", "cell.rviz", "foxglove.json",
    )]  # fmt: skip
    assert (tmp_path / "views" / "cell.rviz").read_text() == rviz_config(load_cell("ur5"))
    assert main(["export", "ur55", "--output", str(tmp_path)]) == 1
    assert "did you mean 'ur5'" in capsys.readouterr().err
