"""Configuration of RViz and layout of Foxglove for a cell: robot, markers, images."""

import json
from typing import Any

import numpy as np
import yaml

from im_cell.robot import Cell
from im_mcs.model import CellModel

_LATCHED, _NEWEST = ("Transient Local", "Reliable"), ("Volatile", "Reliable")
_DISTANCES = 2.2
"""Distance of the eye, in radii of the robot at home."""


def rviz_config(cell: Cell) -> str:
    """Return the configuration of RViz."""
    centre, radius = _extent(cell)
    first = next(iter(cell.cameras), None)
    displays = [
        {
            **_display("Grid", "Grid"),
            "Cell Size": 0.5,
            "Plane": "XY",
            "Plane Cell Count": 16,
            "Color": "160; 160; 160",
            "Alpha": 0.3,
        },
        {
            **_display("RobotModel", "Cell"),
            "Alpha": 1,
            "Description Source": "Topic",
            "Description Topic": _topic("/robot_description", _LATCHED),
            "Visual Enabled": True,
            "Collision Enabled": False,
            "Update Interval": 0,
        },
        {**_display("TF", "Frames", False), "Show Arrows": False, "Show Names": True, "Marker Scale": 0.5},
        {**_display("MarkerArray", "Markers"), "Topic": _topic("/markers", _LATCHED)},
        *(
            {**_display("Image", camera, camera == first), "Topic": _topic(f"/{camera}/image_raw", _NEWEST)}
            for camera in cell.cameras
        ),
    ]
    manager = {
        "Class": "",
        "Displays": displays,
        "Enabled": True,
        "Global Options": {"Background Color": "48; 48; 48", "Fixed Frame": "world", "Frame Rate": 30},
        "Name": "root",
        "Tools": [
            {"Class": f"rviz_default_plugins/{tool}"} for tool in ("MoveCamera", "Select", "FocusCamera", "Measure")
        ],
        "Transformation": {"Current": {"Class": "rviz_default_plugins/TF"}},
        "Value": True,
        "Views": {
            "Current": {
                "Class": "rviz_default_plugins/Orbit",
                "Name": "Current View",
                "Target Frame": "world",
                "Distance": _DISTANCES * radius,
                "Focal Point": dict(zip("XYZ", centre, strict=True)),
                "Pitch": 0.5,
                "Yaw": -1.2,
                "Near Clip Distance": 0.01,
                "Value": "Orbit (rviz)",
            },
            "Saved": None,
        },
    }
    whole = {
        "Panels": [{"Class": f"rviz_common/{panel}", "Name": panel} for panel in ("Displays", "Views", "Time")],
        "Visualization Manager": manager,
        "Window Geometry": {"Height": 900, "Width": 1400},
    }
    return f"# view.launch.py of im_bringup opens it.\n{yaml.safe_dump(whole, sort_keys=False)}"


def foxglove_layout(cell: Cell) -> str:
    """Return the layout of Foxglove: the robot on the left, images, state and diagnostics on the right."""
    centre, radius = _extent(cell)
    images = {
        f"Image!{camera}": {
            "imageMode": {
                "imageTopic": f"/{camera}/image_raw/compressed",
                "calibrationTopic": f"/{camera}/camera_info",
            }
        }
        for camera in cell.cameras
    }
    told = _side("row", "RawMessages!mcs", "DiagnosticSummary!all")
    layout = {
        "configById": {
            "3D!cell": _scene(centre, _DISTANCES * radius),
            **images,
            "RawMessages!mcs": {"topicPath": "/mcs/state"},
            "DiagnosticSummary!all": {
                "topicToRender": "/diagnostics",
                "minLevel": 0,
                "pinnedIds": [],
                "sortByLevel": True,
            },
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _side("row", "3D!cell", _stacked([*images, told]), 62),
    }
    return json.dumps(layout, indent=1) + "\n"


def _extent(cell: Cell) -> tuple[list[float], float]:
    """Return the middle of the shapes at home [m], and the radius of a ball around them, rounded [m]."""
    model = CellModel(cell)
    shapes = [
        *((hull.link, hull.points) for hull in cell.hulls),
        *((capsule.link, (capsule.p0, capsule.p1)) for capsule in cell.capsules_compared),
    ]
    points = np.array([model.pose(cell.home, link).act(np.array(each)) for link, corners in shapes for each in corners])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = [round(value, 2) for value in ((low + high) / 2.0).tolist()]
    return middle, round(float(np.linalg.norm(high - low)) / 2.0, 2) or 1.0


def _display(kind: str, name: str, shown: bool = True) -> dict[str, Any]:
    return {"Class": f"rviz_default_plugins/{kind}", "Name": name, "Enabled": shown, "Value": shown}


def _topic(name: str, quality: tuple[str, str]) -> dict[str, Any]:
    durability, reliability = quality
    return {
        "Depth": 5,
        "Durability Policy": durability,
        "History Policy": "Keep Last",
        "Reliability Policy": reliability,
        "Value": name,
    }


def _scene(centre: list[float], distance: float) -> dict[str, Any]:
    grid = {"layerId": "foxglove.Grid", "instanceId": "grid", "label": "Grid", "visible": True, "frameId": "world"}
    look = {"size": 8, "divisions": 16, "lineWidth": 1, "color": "#80808060"}
    place = {"position": [0, 0, 0], "rotation": [0, 0, 0]}
    robot = {
        "layerId": "foxglove.Urdf",
        "instanceId": "cell",
        "label": "Cell",
        "visible": True,
        "sourceType": "topic",
        "topic": "/robot_description",
        "framePrefix": "",
        "displayMode": "visual",
    }
    camera = {"perspective": True, "distance": distance, "phi": 65, "thetaOffset": 25, "target": centre}
    lens = {"targetOffset": [0, 0, 0], "targetOrientation": [0, 0, 0, 1], "fovy": 45, "near": 0.1, "far": 100}
    return {
        "cameraState": {**camera, **lens},
        "followMode": "follow-none",
        "followTf": "world",
        "scene": {},
        "transforms": {"frame:world": {"visible": True}},
        "topics": {"/markers": {"visible": True}},
        "layers": {"grid": {**grid, **look, **place}, "cell": robot},
    }


def _side(direction: str, first: Any, second: Any, share: float = 50) -> dict[str, Any]:
    return {"direction": direction, "splitPercentage": share, "first": first, "second": second}


def _stacked(panels: list[Any]) -> Any:
    """Return panels one below the other, of equal height."""
    first, *rest = panels
    return _side("column", first, _stacked(rest), round(100 / len(panels), 1)) if rest else first
