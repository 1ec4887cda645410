"""``im vss run --camera NAME:=TOPIC ...``: the Vision Services System alone, on cameras with drivers of their own."""

import argparse
import os
import re
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from sensor_msgs.msg import CameraInfo

from im_calibration.recorded.image_message import grey_image
from im_cell.calibration_files import camera_info_yaml
from im_cell.robot.cell import DEFAULT_CELL, cell_file, resolved
from im_core import clock
from im_core.config import package_file
from im_core.errors import DataError, ImError
from im_core.files import make_folder, read_text, write_whole
from im_core.names import CELL, run_dir
from im_core.options import NumberParser
from im_core.ros import qos
from im_core.ros.guard import GuardedNode
from im_core.ros.run import spin_in_thread
from im_core.text.yamltext import as_data, read_yaml, write_yaml
from im_vss.ros.image_topics import TopicImages
from im_vss.ros.messages import from_camera_info

_FIRST_S = 10.0
"""How long the first image of each camera is awaited [s]."""
_LENGTH = re.compile(r"(\d+)(?:-(\d+))?=([0-9.]+)(mm|cm|m)")
_UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
_DESCRIPTION = "Run the Vision Services System alone, on cameras with drivers of their own."
_EXAMPLE = "example: scripts/im vss run --camera left:=/left/image_raw right:=/right/image_raw --fiducials 0-9=80mm"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default with the arguments of the process; return the exit code of ``/vss``."""
    parser = NumberParser(prog="im vss", description=_DESCRIPTION, epilog=_EXAMPLE)
    parser.add_argument("action", choices=["run"])
    parser.add_argument(
        "--camera", nargs="+", required=True, type=_remapped, metavar="NAME:=TOPIC", help="topics of images"
    )
    parser.add_argument("--fiducials", nargs="+", default=[], type=_plates, metavar="IDS=SIDE", help="such as 0-9=80mm")
    parser.add_argument(
        "--light", default="", metavar="SERVICE", help="std_srvs/SetBool that switches the light of spots"
    )
    parser.add_argument("--settings", type=Path, help="file like vss.yaml, for what a spot is and the sensors' noise")
    options = parser.parse_args(arguments)
    cameras = dict(options.camera)
    if len(cameras) < len(options.camera):
        parser.error("each camera may be given once")
    try:
        plates = {number: size for each in options.fiducials for number, size in each.items()}
        folder = run_dir() / "vss_alone"
        write_files(folder, first_images(cameras), cameras, plates, options.light, options.settings)
    except ImError as error:
        print(f"vss: {error.message}", file=sys.stderr)
        return 1
    os.environ[CELL] = str(folder / "cell.yaml")
    given = {"standalone": "true", "settings": folder / "vss.yaml", "calibration": folder / "calibration"}
    parameters = [part for name, value in given.items() for part in ("-p", f"{name}:={value}")]
    sys.argv = ["vss", "--ros-args", *parameters]
    from im_vss.ros.node import main as run

    return run()


def first_images(topics: Mapping[str, str]) -> dict[str, tuple[tuple[int, int], CameraInfo | None]]:
    """Return image size and camera info of each camera, of the first image on the topic and of the topic beside.

    Raises:
        WaitTimeoutError: A camera sends no image.
        DataError: An image is of an unknown encoding.
    """
    rclpy.init(args=[])
    node = GuardedNode("vss_first_images")
    infos: dict[str, CameraInfo] = {}
    beside = {name: f"{_camera_of(topic)}/camera_info" for name, topic in topics.items()}
    for name, topic in beside.items():
        node.create_subscription(CameraInfo, topic, partial(infos.__setitem__, name), qos.SENSOR)
    images = TopicImages(node, topics)
    spinner = spin_in_thread(node)
    try:
        found, deadline = {}, clock.monotonic() + _FIRST_S
        for name, topic in topics.items():
            image = grey_image(images.after(name, 0, deadline, _FIRST_S), topic)
            found[name] = (image.shape[1], image.shape[0])
        return {name: (size, infos.get(name)) for name, size in found.items()}
    finally:
        spinner.stop()
        rclpy.try_shutdown()


def write_files(
    folder: Path,
    found: Mapping[str, tuple[tuple[int, int], CameraInfo | None]],
    topics: Mapping[str, str],
    plates: Mapping[int, float],
    light: str,
    settings: Path | None,
) -> None:
    """Write cell file, settings and calibration of cameras and fiducials into a folder.

    Args:
        folder: The folder.
        found: Image size [px] and camera info of each camera.
        topics: Of each camera.
        plates: Side of each fiducial, by number [m].
        light: Service that switches the light; empty: none.
        settings: File like ``vss.yaml``; None: the shipped one.

    Raises:
        DataError: A camera info cannot be used.
        StoreError: A file cannot be written.
    """
    make_folder(folder / "calibration")
    for left in (folder / "calibration").iterdir():
        left.unlink()
    base = cell_file(os.environ.get(CELL) or DEFAULT_CELL)
    cell = _content(base)
    cell["urdf"] = str(resolved(cell["urdf"], base))
    cell["cameras"] = {name: _camera(*size) for name, (size, _) in found.items()}
    cell["targets"] = [
        {"name": f"fiducial_{number}", "kind": "fiducial", "id": number, "size": size, "plate": 1.5 * size,
         "position": [0.0, 0.0, 0.0], "normal": [0.0, 0.0, 1.0], "up": [0.0, 1.0, 0.0]}
        for number, size in plates.items()
    ]  # fmt: skip
    write_whole(folder / "cell.yaml", write_yaml(cell))
    own = _content(settings or package_file("im_vss", "config/vss.yaml"))
    own |= {
        "cameras": list(found),
        "stereo": {**own["stereo"], "pairs": []},
        "frame_source": {
            "implementation": "im_vss.ros.image_topics:ImageTopics",
            "settings": {"topics": dict(topics), "light": light},
        },
    }
    write_whole(folder / "vss.yaml", write_yaml(own))
    for name, (_, info) in found.items():
        if info is not None and info.k[0] > 0.0:
            write_whole(folder / "calibration" / f"{name}.yaml", camera_info_yaml(name, from_camera_info(info)))


def _content(path: Path) -> dict[str, Any]:
    content = as_data(read_yaml(read_text(path), str(path)))
    if not isinstance(content, dict):
        raise DataError(f"{path}: is no mapping.", file=str(path))
    return content


def _camera(width: int, height: int) -> dict[str, Any]:
    """Return a camera at the origin of the world, with a lens of the usual angle until it is calibrated."""
    lens = {"width": width, "height": height, "fx": float(width), "fy": float(width),
            "cx": (width - 1) / 2.0, "cy": (height - 1) / 2.0}  # fmt: skip
    place = {"position": [0.0, 0.0, 0.0], "target": [0.0, 0.0, 1.0], "up": [0.0, -1.0, 0.0]}
    return {"parent": "world", **place, "intrinsics": lens}


def _camera_of(topic: str) -> str:
    """Return the namespace of a camera: that of its image topic, without the transport."""
    return topic.removesuffix("/compressed").rpartition("/")[0]


def _remapped(text: str) -> tuple[str, str]:
    name, remapped, topic = text.partition(":=")
    if not (name and remapped and topic.startswith("/")):
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form NAME:=/TOPIC")
    return name, topic


def _plates(text: str) -> dict[int, float]:
    """Return the side of each fiducial [m] of a text such as ``0-9=80mm``."""
    match = _LENGTH.fullmatch(text)
    if match is None:
        raise argparse.ArgumentTypeError(f"'{text}' is not of the form 3=80mm or 0-9=80mm")
    first, last = int(match[1]), int(match[2] or match[1])
    return dict.fromkeys(range(first, last + 1), float(match[3]) * _UNITS[match[4]])


if __name__ == "__main__":
    sys.exit(main())
