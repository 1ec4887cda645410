"""Markers of the cameras' views and residuals, the lights, targets and the workspace, for RViz and Foxglove."""

import numpy as np
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA, String
from visualization_msgs.msg import Marker, MarkerArray

from im_cell.camera_model import Array
from im_cell.lights import lights_told
from im_cell.robot import Cell
from im_cell.robot.scenery import Target
from im_cell.workspace import Workspace
from im_core.ros import qos
from im_core.ros.node import ManagedNode
from im_vss.camera_book import CameraBook, CameraEntry
from im_vss.ros.messages import to_pose

_DEPTH_M = 0.5
"""How far from the camera its view is drawn."""
_CALIBRATED, _DRAWN = ColorRGBA(r=0.3, g=0.9, b=0.4, a=1.0), ColorRGBA(r=0.7, g=0.7, b=0.7, a=1.0)
_LIT, _DARK = ColorRGBA(r=1.0, g=0.95, b=0.6, a=1.0), ColorRGBA(r=0.3, g=0.3, b=0.3, a=1.0)
_LEFT, _PLATE = ColorRGBA(r=1.0, g=0.3, b=0.2, a=1.0), ColorRGBA(r=0.95, g=0.95, b=0.95, a=1.0)
_RESIDUALS_TIMES = 100.0
"""How many times as long as they are residuals are drawn."""
_PLATE_M = 0.002
_WORKSPACE = ColorRGBA(r=0.3, g=0.5, b=1.0, a=0.12)


class ResidualMarkers:
    """Namespace ``residuals`` of ``/markers``, latched, for subscribers only: the spots of the last calibrations."""

    def __init__(self, node: ManagedNode, book: CameraBook) -> None:
        self._book = book
        self._shown: MarkerArray | None = None
        self._publisher = node.create_publisher(MarkerArray, "/markers", qos.LATCHED)

    def publish(self) -> None:
        """Publish what has changed since the last call, or everything to the first subscriber."""
        if not self._publisher.get_subscription_count():
            self._shown = None
            return
        present = MarkerArray(markers=self._markers())
        if present != self._shown:
            self._shown = present
            self._publisher.publish(present)

    def _markers(self) -> list[Marker]:
        left = self._book.residuals
        ranked = enumerate(self._book.entries())
        return [_residuals(rank, entry, *left[entry.name]) for rank, entry in ranked if entry.name in left]


class CellMarkers(ResidualMarkers):
    """``/markers`` of ``/vss``.

    Namespaces ``cameras``, ``residuals``, ``lights``, ``objects`` and ``workspace``. Each is in the frame it is
    fixed to, which ``/tf`` moves. A camera that is as drawn is grey.
    """

    def __init__(self, node: ManagedNode, cell: Cell, book: CameraBook) -> None:
        super().__init__(node, book)
        self._cell = cell
        self._lights = dict.fromkeys(cell.light_names, False)
        node.create_subscription(String, "/testbed/lights", self._switched, qos.LATCHED)

    def _markers(self) -> list[Marker]:
        ranked = enumerate(self._book.entries())
        markers = [_view(rank, entry) for rank, entry in ranked if entry.model.invertible_share]
        markers += super()._markers()
        markers += [_plate(rank, target) for rank, target in enumerate(self._cell.targets)]
        markers += [self._light(rank, name, lit) for rank, (name, lit) in enumerate(self._lights.items())]
        box = self._cell.workspace_box
        return markers if box is None else [*markers, _workspace(box)]

    def _switched(self, message: String) -> None:
        self._lights = lights_told(message.data, self._cell)

    def _light(self, rank: int, name: str, lit: bool) -> Marker:
        marker = _marker("lights", rank, name, Marker.SPHERE, _LIT if lit else _DARK)
        size = self._cell.led.diameter * (2.0 if lit else 1.0)
        marker.scale.x = marker.scale.y = marker.scale.z = size
        return marker


def _view(rank: int, entry: CameraEntry) -> Marker:
    """Return the edges of a camera's view: from the centre through the corners of the image, and around.

    Of an image with corners in which the lens cannot be inverted, they are those of the part in which it can be.
    """
    model = entry.model
    ideal = model.undistort(model.corners(model.invertible_share))
    ends = [Point(x=_DEPTH_M * x, y=_DEPTH_M * y, z=_DEPTH_M) for x, y in ideal.tolist()]
    marker = _marker("cameras", rank, entry.frame, Marker.LINE_LIST, _CALIBRATED if entry.calibrated else _DRAWN)
    marker.scale.x = 0.005
    for end, following in zip(ends, [*ends[1:], ends[0]], strict=True):
        marker.points.extend((Point(), end, end, following))
    return marker


def _residuals(rank: int, entry: CameraEntry, spots: Array, residuals: Array) -> Marker:
    """Return a line for each spot of a calibration, on the view's far end: from the predicted place on."""
    marker = _marker("residuals", rank, entry.frame, Marker.LINE_LIST, _LEFT)
    marker.scale.x = 0.002
    seen = np.isfinite(spots).all(axis=1) & np.isfinite(residuals).all(axis=1)
    if seen.any():
        rms_px = np.sqrt((residuals[seen] ** 2).sum(axis=1).mean())
        marker.text = f"{rms_px:.3f} px rms of {seen.sum()} spots"
    predicted = spots[seen] - residuals[seen]
    for ends in zip(predicted, predicted + _RESIDUALS_TIMES * residuals[seen], strict=True):
        # the lens's share of so short a line is not worth an inversion that may fail outside of the image
        ideal = (np.array(ends) - entry.model.K[:2, 2]) / np.diag(entry.model.K)[:2]
        marker.points.extend(Point(x=_DEPTH_M * x, y=_DEPTH_M * y, z=_DEPTH_M) for x, y in ideal.tolist())
    return marker


def _plate(rank: int, target: Target) -> Marker:
    marker = _marker("objects", rank, target.parent, Marker.CUBE, _PLATE)
    rotation, position = target.pose()
    marker.pose = to_pose(position, rotation)
    marker.scale.x, marker.scale.y, marker.scale.z = target.plate, target.plate, _PLATE_M
    return marker


def _workspace(box: Workspace) -> Marker:
    marker = _marker("workspace", 0, "world", Marker.CUBE, _WORKSPACE)
    low, high = np.array(box.low), np.array(box.high)
    center, position = (low + high) / 2.0, marker.pose.position
    position.x, position.y, position.z = center.tolist()
    marker.scale.x, marker.scale.y, marker.scale.z = (high - low).tolist()
    return marker


def _marker(namespace: str, number: int, frame: str, kind: int, color: ColorRGBA) -> Marker:
    """Return a marker that goes with its frame, at whatever time."""
    marker = Marker(ns=namespace, id=number, type=kind, action=Marker.ADD, color=color, frame_locked=True)
    marker.header.frame_id = frame
    return marker
