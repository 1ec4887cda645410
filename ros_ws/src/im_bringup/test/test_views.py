"""What RViz and Foxglove are configured to show, against the topics and types of the machine."""

import json
import re
from pathlib import Path

import yaml
from ament_index_python.packages import get_package_share_directory

from im_cell.robot import load_cell

SHARE = Path(get_package_share_directory("im_bringup"))
PAGE = (Path(__file__).parents[4] / "docs" / "interfaces.md").read_text()
TOPICS = dict(re.findall(r"\| `(/\S+)` \| `(\S+)` \|", PAGE.partition("## Topics")[2]))
#: Types that displays of RViz and panels of Foxglove take.
RVIZ = {
    "RobotModel": "std_msgs/msg/String",
    "MarkerArray": "visualization_msgs/msg/MarkerArray",
    "Image": "sensor_msgs/msg/Image",
}
LATCHED = ("/robot_description", "/markers")


def test_rviz_shows_topics_of_the_machine_as_they_are_published():
    manager = yaml.safe_load((SHARE / "rviz" / "cell.rviz").read_text())["Visualization Manager"]
    assert manager["Global Options"]["Fixed Frame"] == "world"
    shown = {}
    for display in manager["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            shown[topic["Value"]] = display["Class"].removeprefix("rviz_default_plugins/")
            latched = topic["Value"] in LATCHED
            assert topic["Durability Policy"] == ("Transient Local" if latched else "Volatile")
    assert {topic: TOPICS[topic] for topic in shown} == {topic: RVIZ[kind] for topic, kind in shown.items()}
    assert shown.keys() == {*LATCHED, *(f"/{camera}/image_raw" for camera in load_cell().cameras)}


def panels(layout):
    """Names of the panels in a layout, from first to last."""
    if isinstance(layout, str):
        return [layout]
    return [*panels(layout["first"]), *panels(layout["second"])]


def test_foxglove_shows_topics_of_the_machine():
    told = json.loads((SHARE / "foxglove" / "cell.json").read_text())
    config = told["configById"]
    assert panels(told["layout"]) == list(config)
    scene = config["3D!cell"]
    assert scene["layers"]["cell"]["topic"] in TOPICS
    assert {TOPICS[topic] for topic in scene["topics"]} == {"visualization_msgs/msg/MarkerArray"}
    images = [panel["imageMode"] for name, panel in config.items() if name.startswith("Image!")]
    for image in images:
        assert TOPICS[image["imageTopic"]] == "sensor_msgs/msg/CompressedImage"
        assert TOPICS[image["calibrationTopic"]] == "sensor_msgs/msg/CameraInfo"
    assert config["RawMessages!mcs"]["topicPath"] in TOPICS
    assert config["DiagnosticSummary!all"]["topicToRender"] in TOPICS
