"""docs/tutorials/vision_service.md: its module, Tool and Service are loaded and called, as the page says."""

import os
import re
from pathlib import Path

import pytest
import yaml
from std_srvs.srv import Trigger

from im_core.config import package_file
from im_core.ros.calls import call_blocking
from im_msgs.srv import VisionQuery

PAGE = Path(__file__).resolve().parents[1] / "docs" / "tutorials/vision_service.md"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """What the page says to write: the Python files, and the two configuration files with what it adds to them."""
    blocks = re.findall(
        r"^```(python|yaml) (\S+)\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )
    assert len(blocks) == 5
    for language, name, text in blocks:
        if language == "python":
            (tmp_path / name).write_text(text, encoding="utf-8")
            continue
        content = yaml.safe_load(package_file("im_vss", f"config/{name}").read_text(encoding="utf-8"))
        for section, added in yaml.safe_load(text).items():
            content[section] = {**content[section], **added} if isinstance(added, dict) else added
        (tmp_path / name).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("IM_RUN_DIR", str(tmp_path))
    return tmp_path


def test_what_the_page_adds_is_all_that_is_loaded_and_it_answers(folder, wait_until):
    import rclpy

    from im_core.ros.run import spin_in_thread
    from im_sim.ros.node import TestbedNode
    from im_vss.ros.node import VssNode

    settings = {"standalone": "true", "factor": "0.0", "seed": "4"}
    files = {name: str(folder / f"{file}.yaml") for name, file in (("catalogue", "catalogue"), ("settings", "vss"))}
    arguments = [part for name, value in {**settings, **files}.items() for part in ("-p", f"{name}:={value}")]
    rclpy.init(args=["--ros-args", *arguments])
    spinners = []
    try:
        testbed, client = TestbedNode(), rclpy.create_node("client")
        spinners.append(spin_in_thread(testbed, client))
        wait_until(lambda: testbed.ready or testbed.failed, "the testbed")
        vss = VssNode()
        spinners.append(spin_in_thread(vss))
        wait_until(lambda: vss.ready or vss.failed, "the node")
        assert vss.ready, vss.failed
        answer = call_blocking(client.create_client(Trigger, "/vss/light_meter"), Trigger.Request(), 60.0, "light")
        assert answer.success, answer.message
        assert re.fullmatch(r"\d+\.\d DN: enough light to work by", answer.message)
        query = client.create_client(VisionQuery, "/vss/query")
        state = call_blocking(query, VisionQuery.Request(), 60.0, "state").state
        assert (state.services, state.tools) == (["light_meter"], ["tool_snap", "tool_light_meter"])
        assert {module.name: module.released for module in state.modules} == {"vm_snap": 1, "vm_light_meter": 1}
        assert client.count_services("/vss/snap") == 0
    finally:
        for spinner in reversed(spinners):
            spinner.stop()
        rclpy.try_shutdown()
    assert not [name for name in os.listdir("/dev/shm") if name.startswith(f"im{os.environ['ROS_DOMAIN_ID']}_vss")]
