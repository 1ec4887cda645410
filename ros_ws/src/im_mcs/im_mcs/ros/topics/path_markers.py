"""Markers of the planned paths of the wrists, for RViz and Foxglove."""

import threading
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from numpy.typing import NDArray
from visualization_msgs.msg import Marker, MarkerArray

from im_core.ros import qos
from im_mcs.client.groups import best_positions
from im_mcs.inverse import Arm, ArmTracker
from im_mcs.model.part import part_of
from im_mcs.planning.line.route import Route
from im_mcs.protocol.points import unpack_points
from im_mcs.protocol.requests import LineMove
from im_mcs.ros.access import McsAccess

_STEPS = 20
"""Straight pieces that are drawn of a leg that is straight in joint space."""
_MOST_POINTS = 200


class PathMarkers:
    """``/markers`` of ``/mcs``: namespace ``paths``, a line in ``world`` for each wrist; latched, if subscribed to."""

    def __init__(self, access: McsAccess) -> None:
        self._mcs = access
        self._lock = threading.Lock()
        self._paths: dict[str, tuple[NDArray[np.float64], dict[str, Any]]] = {}
        self._due = True
        self._publisher = access.node.create_publisher(MarkerArray, "/markers", qos.LATCHED)

    def begin(self, group: str, path: dict[str, Any]) -> None:
        """Take the path of a MOVE request that a group begins; in any thread."""
        start = best_positions(self._mcs.client().snapshot())
        with self._lock:
            self._paths[group], self._due = (start, path), True

    def end(self, group: str) -> None:
        """Forget the path of a group."""
        with self._lock:
            self._paths.pop(group, None)
            self._due = True

    def publish(self) -> None:
        """Publish what has changed since the last call, or everything to the first subscriber; in the node's loop."""
        listened = self._publisher.get_subscription_count() > 0
        with self._lock:
            due, paths = self._due and listened, dict(self._paths)
            self._due = not listened
        if due:
            lines: dict[str, NDArray[np.float64]] = {}
            for group, (start, path) in paths.items():
                lines.update(self._lines(group, start, path))
            names = [each.tip for each in self._mcs.cell.groups.values()]
            self._publisher.publish(
                MarkerArray(markers=[_line(rank, lines.get(name)) for rank, name in enumerate(names)])
            )

    def _lines(self, group: str, start: NDArray[np.float64], path: dict[str, Any]) -> dict[str, NDArray[np.float64]]:
        """Return the places that each wrist of a group passes, shape (m, 3) [m]."""
        model, part = self._mcs.model, part_of(group, self._mcs.config, self._mcs.cell)
        if path["kind"] == "line":
            return self._routes(group, start, LineMove.model_validate(path), part.wrists)
        index = [model.index(joint) for joint in part.joints]
        if path["kind"] == "joint":
            ends = np.array([start[index], *path["points"]])
            shares = np.linspace(0.0, 1.0, _STEPS, endpoint=False)[:, None]
            legs = [a + shares * (b - a) for a, b in pairwise(ends)]
            passed = np.concatenate([*legs, ends[-1:]])
        else:
            passed = unpack_points(path["points"]).q
        passed = passed[np.linspace(0, len(passed) - 1, min(len(passed), _MOST_POINTS)).astype(np.intp)]
        q = np.tile(start, (len(passed), 1))
        q[:, index] = passed
        return {wrist: np.array([model.pose(row, wrist).translation for row in q]) for wrist in part.wrists}

    def _routes(
        self, group: str, start: NDArray[np.float64], move: LineMove, wrists: Sequence[str]
    ) -> dict[str, NDArray[np.float64]]:
        """Return the places that one or two wrists pass on lines or arcs, shape (m, 3) [m]."""
        model = self._mcs.model
        trackers = [ArmTracker(model, Arm(model, wrist), wrist) for wrist in wrists]
        lead = np.array([model.index(joint) for joint in self._mcs.lead_joints(group)], dtype=np.intp)
        lever = self._mcs.config.planning.line.rotation_lever_m
        route = Route(move, start, lead, trackers, model.cell, lever)
        places: dict[str, list[NDArray[np.float64]]] = {wrist: [] for wrist in wrists}
        for run in route.runs():
            stops = [route.stops[number] for number in run]
            for wrist, second in zip(wrists, (False, True), strict=False):
                drawn = route.path(stops, np.zeros((len(stops), 0)), second=second)
                s = np.linspace(0.0, drawn.size, _STEPS * (len(stops) - 1) + 1)
                places[wrist] += [drawn.at(float(each)).pose.translation for each in s]
        return {wrist: np.array(passed) for wrist, passed in places.items() if passed}


def _line(rank: int, points: NDArray[np.float64] | None) -> Marker:
    """Return the marker of a wrist; None: that which takes the one before away."""
    marker = Marker(ns="paths", id=rank, type=Marker.LINE_STRIP, action=Marker.DELETE if points is None else Marker.ADD)
    marker.header.frame_id = "world"
    marker.scale.x = 0.008
    marker.color.r, marker.color.g, marker.color.b, marker.color.a = 1.0, 0.6, 0.1, 1.0
    if points is not None:
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in points.tolist()]
    return marker
