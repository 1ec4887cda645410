"""Messages on the cell become plain data; what no page could draw is refused."""

import base64
from types import SimpleNamespace as Message

import pytest
from PIL import Image

from im_core.errors import ImError
from im_pnt_display.page import cell

NAN = float("nan")


def point(x=0.0, y=0.0, z=0.0):
    return Message(x=x, y=y, z=z)


def color(r=0.0, g=0.0, b=0.0, a=1.0):
    return Message(r=r, g=g, b=b, a=a)


def marker(**changes):
    pose = Message(position=point(1.0), orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0))
    fields = {
        "ns": "paths", "id": 1, "type": 4, "action": 0, "header": Message(frame_id="world"), "pose": pose,
        "text": "2 spots", "scale": point(0.1), "color": color(), "points": [point(), point(y=2.0)],
    }  # fmt: skip
    return Message(**{**fields, **changes})


def image(encoding="mono8", width=3, height=2, step=4, data=bytes(8)):
    return Message(encoding=encoding, width=width, height=height, step=step, data=data)


def test_positions_of_joints_are_told_by_name():
    assert cell.joints(Message(name=["a", "b"], position=[0.5, -1.0])) == ("joints", {"a": 0.5, "b": -1.0})


@pytest.mark.parametrize("message", [Message(name=["a"], position=[]), Message(name=["a"], position=[NAN])])
def test_joints_without_a_position_each_are_refused(message):
    with pytest.raises(ImError):
        cell.joints(message)


def test_a_frame_tells_what_it_is_fixed_to():
    turn = Message(x=0.0, y=0.0, z=0.0, w=1.0)
    told = Message(
        header=Message(frame_id="world"),
        child_frame_id="wall",
        transform=Message(translation=point(1.0, 2.0, 3.0), rotation=turn),
    )
    content = {"parent": "world", "xyz": [1.0, 2.0, 3.0], "quaternion": [0.0, 0.0, 0.0, 1.0]}
    assert list(cell.frames(Message(transforms=[told]))) == [("frame/wall", content)]


def test_markers_come_and_go():
    [(name, content)] = cell.markers(Message(markers=[marker()]))
    assert content["text"] == "2 spots"
    assert (name, content["kind"], content["points"]) == ("marker/paths/1", "strip", [[0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    assert next(cell.markers(Message(markers=[marker(type=11)])))[1]["kind"] == "faces"
    for gone in (marker(action=2), marker(type=10)):
        assert list(cell.markers(Message(markers=[gone]))) == [("marker/paths/1", None)]


@pytest.mark.parametrize("wrong", [{"scale": point(NAN)}, {"points": [point()] * (cell.MOST_POINTS + 1)}])
def test_markers_that_no_page_could_draw_are_refused(wrong):
    with pytest.raises(ImError):
        list(cell.markers(Message(markers=[marker(**wrong)])))


@pytest.mark.parametrize(("encoding", "mode", "size"), [("mono8", "L", 1), ("rgb8", "RGB", 3)])
def test_an_image_is_packed_as_other_programs_read_it(tmp_path, encoding, mode, size):
    width, height, step = 3, 2, 3 * size + 1
    data = bytes(range(step * height))
    name, address = cell.png("wall", image(encoding, width, height, step, data))
    (tmp_path / "image.png").write_bytes(base64.b64decode(address.removeprefix("data:image/png;base64,")))
    with Image.open(tmp_path / "image.png") as read:
        assert (read.size, read.mode) == ((width, height), mode)
        rows = b"".join(data[row * step : row * step + width * size] for row in range(height))
        assert read.tobytes() == rows
    assert name == "image/wall"


@pytest.mark.parametrize("wrong", [{"encoding": "yuv422"}, {"step": 2}, {"data": bytes(7)}])
def test_an_image_that_is_none_is_refused(wrong):
    with pytest.raises(ImError):
        cell.png("wall", image(**wrong))


def test_a_spot_that_was_not_found_has_no_place():
    assert cell.spot("wall", Message(point=point(1.5, 2.5))) == ("spot/wall", (1.5, 2.5))
    assert cell.spot("wall", Message(point=point(NAN, 2.5))) == ("spot/wall", None)
