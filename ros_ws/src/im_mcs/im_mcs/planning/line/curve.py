"""Joint positions along a straight line of the wrist, refined until the line is kept; refusals name joint and place."""

from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from im_core.errors import DataError, ImError, LimitError
from im_mcs.inverse import ArmTracker, Tracked
from im_mcs.inverse.arm import Arm
from im_mcs.limits.limits import JointLimits
from im_mcs.planning.line.geometry import PathPlace, WristPath
from im_mcs.planning.trajectories.polynomial import quintic

_FIRST_STEP_M = 0.04
_SMALLEST_STEP_M = 5e-4
# Deviations this much smaller than allowed let the next step be longer.
_EASY = 1.0 / 100.0
_CHECKED_AT = (0.25, 0.5, 0.75)
_REACH_CHECKS = 32
_REACH_CHECKS_A_STEP = 8
_ROUNDING = 1e-9


class JointCurve:
    """Joint positions over a path parameter: quintics through places with two derivatives.

    Args:
        s: Path parameter of the places, strictly increasing, shape (m + 1,) [m].
        coefficients: Ascending powers of the parameter since the place before, shape (m, 6, n).
    """

    def __init__(self, s: NDArray[np.float64], coefficients: NDArray[np.float64]) -> None:
        self._s = s
        self._coefficients = coefficients

    def at(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value and three derivatives at ``s``, shape (m,): shape (4, m, n)."""
        i = np.clip(np.searchsorted(self._s, s, side="right") - 1, 0, len(self._coefficients) - 1)
        x, c = (s - self._s[i])[:, None], self._coefficients[i]
        c0, c1, c2, c3, c4, c5 = (c[:, k] for k in range(6))
        return np.stack(
            [
                c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * c5)))),
                c1 + x * (2.0 * c2 + x * (3.0 * c3 + x * (4.0 * c4 + x * 5.0 * c5))),
                2.0 * c2 + x * (6.0 * c3 + x * (12.0 * c4 + x * 20.0 * c5)),
                6.0 * c3 + x * (24.0 * c4 + x * 60.0 * c5),
            ]
        )


class JointCurves:
    """Curves of several arms over one path parameter; other joints stand still.

    Args:
        q: Positions of all joints of the group, shape (n,) [rad or m].
        curves: For each arm the ranks of its joints in the group, and its curve.
    """

    def __init__(self, q: NDArray[np.float64], curves: Sequence[tuple[NDArray[np.intp], JointCurve]]) -> None:
        self._q, self._curves = q, curves

    def at(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Value and three derivatives at ``s``, shape (m,): shape (4, m, n)."""
        whole = np.zeros((4, len(s), len(self._q)))
        whole[0] = self._q
        for ranks, curve in self._curves:
            whole[:, :, ranks] = curve.at(s)
        return whole


class LineCurve:
    """Walks along a path of the wrist and makes the joints' curve.

    Args:
        tracker: Inverse kinematics of the arm.
        arm: Its singularities and reach.
        limits: Of all joints.
        index: Joints of the group, shape (n,).
        path: Of the wrist.
        frame: Name of the wrist.
        singular_value: Smallest allowed of the arm's Jacobian.
        deviation: Largest allowed distance from the path [m].
        lever: Way that a rotation of one radian counts as [m].
        numbers: Number of the pose that each line leads to, for messages.
    """

    def __init__(
        self,
        tracker: ArmTracker,
        arm: Arm,
        limits: JointLimits,
        index: NDArray[np.intp],
        path: WristPath,
        frame: str,
        singular_value: float,
        deviation: float,
        lever: float,
        numbers: Sequence[int],
    ) -> None:
        self._tracker, self._arm, self._limits, self._index = tracker, arm, limits, index
        self._path, self._frame = path, frame
        self._singular_value, self._deviation, self._lever = singular_value, deviation, lever
        self._numbers = numbers

    def walk(self, start: NDArray[np.float64]) -> Generator[None, None, tuple[JointCurve, NDArray[np.float64]]]:
        """Return the joints' curve, and all joints at the end; a step does half the work of one place.

        Args:
            start: Positions of all joints at the beginning of the path, shape (n,) [rad or m].

        Raises:
            LimitError: A joint would pass its range.
            ImError: The arm would become singular (code ``singular``), or the path leaves its reach (``unreachable``).
        """
        yield from self._require_reach(start)
        here = self._place(0.0, start)
        if isinstance(here, ImError):
            raise here
        s, step, places = 0.0, _FIRST_STEP_M, [(0.0, here)]
        for edge in self._path.edges[1:]:
            while s < edge - _ROUNDING:
                end = edge if s + 1.5 * step > edge else s + step  # no crumb of a step before an edge
                there = self._next(s, here, end)
                yield
                smallest = end - s <= _SMALLEST_STEP_M
                if isinstance(there, ImError):
                    if smallest:  # a longer step may fail although the path is sound
                        raise there
                    step = (end - s) / 2.0
                    continue
                off = self._off(s, here, end, there)
                yield
                if off > self._deviation and not smallest:
                    step = (end - s) / 2.0
                    continue
                s, here = end, there
                places.append((s, here))
                if off < _EASY * self._deviation:
                    step *= 2.0
        return self._curve(places), here.q

    def _next(self, s: float, here: Tracked, end: float) -> Tracked | ImError:
        """Joints at ``end``, coming from ``s``."""
        h = end - s
        there = self._place(end, here.q + h * (here.dq + 0.5 * h * here.ddq))
        if isinstance(there, ImError):
            return there
        for name, a, b in zip(self._arm.singularities, here.factors, there.factors, strict=True):
            if a * b < 0.0:
                return self._singular(name, end, there)
        return there

    def _place(self, s: float, guess: NDArray[np.float64]) -> Tracked | ImError:
        """Return joints at ``s``, if allowed there."""
        place = self._path.at(s)
        carriers = self._arm.carriers
        q = guess.copy()
        q[carriers] = place.carriers[0]
        found = self._tracker.solve(place.pose, q)
        tracked = self._tracked(found, place) if found is not None else None
        if tracked is None:
            worst = int(np.argmin(np.abs(self._arm.factors(q[self._arm.joints]))))
            return self._singular(self._arm.singularities[worst], s, None)
        if tracked.singular_value < self._singular_value:
            worst = int(np.argmin(np.abs(tracked.factors)))
            return self._singular(self._arm.singularities[worst], s, tracked)
        for i in self._index:
            value, lower, upper = float(tracked.q[i]), float(self._limits.lower[i]), float(self._limits.upper[i])
            if not lower - _ROUNDING <= value <= upper + _ROUNDING:
                return self._limit(int(i), value, lower if value < lower else upper, s)
        return tracked

    def _tracked(self, q: NDArray[np.float64], place: PathPlace) -> Tracked | None:
        dq, ddq = np.zeros(len(q)), np.zeros(len(q))
        dq[self._arm.carriers], ddq[self._arm.carriers] = place.carriers[1:]
        return self._tracker.derivatives(q, dq, ddq, place.pose, place.twist, place.twist_rate)

    def _off(self, s: float, here: Tracked, end: float, there: Tracked) -> float:
        """How far the quintic between two places is off the path, rotations counted by the lever [m]."""
        curve = self._curve([(s, here), (end, there)])
        between = s + (end - s) * np.array(_CHECKED_AT)
        whole, off = here.q.copy(), 0.0
        for place, q in zip(between, curve.at(between)[0], strict=True):
            whole[self._index] = q
            error = self._tracker.error(self._path.at(float(place)).pose, whole)
            off = max(off, float(np.linalg.norm(error[:3])), self._lever * float(np.linalg.norm(error[3:])))
        return off

    def _curve(self, places: list[tuple[float, Tracked]]) -> JointCurve:
        s = np.array([place[0] for place in places])
        q, dq, ddq = (np.array([getattr(place[1], x)[self._index] for place in places]) for x in ("q", "dq", "ddq"))
        return JointCurve(s, quintic(np.diff(s), q, dq, ddq))

    # refusals

    def _require_reach(self, q_all: NDArray[np.float64]) -> Generator[None, None, None]:
        beyond = []
        for k in range(_REACH_CHECKS + 1):
            beyond.append(self._beyond(self._path.size * k / _REACH_CHECKS, q_all))
            if k % _REACH_CHECKS_A_STEP == 0:
                yield
        worst = max(beyond)
        if worst == 0.0:
            return
        first = next(k for k, far in enumerate(beyond) if far > 0.0)
        inside, outside = (self._path.size * max(k, 0) / _REACH_CHECKS for k in (first - 1, first))
        while outside - inside > _SMALLEST_STEP_M:
            middle = (inside + outside) / 2.0
            inside, outside = (inside, middle) if self._beyond(middle, q_all) > 0.0 else (middle, outside)
        raise DataError(
            f"{self._frame} leaves the arm's reach {self._where(outside)}, by up to {worst * 1e3:.1f} mm",
            code="unreachable",
            frame=self._frame,
            beyond_m=worst,
            **self._facts(outside),
        )

    def _beyond(self, s: float, q_all: NDArray[np.float64]) -> float:
        place = self._path.at(s)
        q = q_all.copy()
        q[self._arm.carriers] = place.carriers[0]
        return self._arm.beyond_reach(q, place.pose.translation)

    def _limit(self, joint: int, value: float, limit: float, s: float) -> LimitError:
        error = LimitError(
            joint=self._limits.names[joint],
            value=value,
            limit=limit,
            unit=self._limits.units[joint],
            what=f"position {self._where(s)}:",
        )
        error.facts.update(self._facts(s))
        return error

    def _singular(self, name: str, s: float, there: Tracked | None) -> ImError:
        rank = {"shoulder": 0, "elbow": 2, "wrist": 4, "arm": -1}[name]
        joint = self._limits.names[int(self._arm.joints[rank])]
        what = {
            "shoulder": f"the wrist over the axis of {joint}",
            "elbow": f"the arm stretched or folded at {joint}",
            "wrist": f"{joint} at 0",
            "arm": f"a direction in which no joint up to {joint} moves the wrist",
        }[name]
        value = "" if there is None else f", smallest singular value {there.singular_value:.3g}"
        return ImError(
            f"{name} singularity ({what}) {self._where(s)}{value}; {self._singular_value:g} is the least allowed",
            code="singular",
            singularity=name,
            joint=joint,
            singular_value=None if there is None else there.singular_value,
            limit=self._singular_value,
            **self._facts(s),
        )

    def _where(self, s: float) -> str:
        facts = self._facts(s)
        x, y, z = facts["position_m"]
        way = f"{facts['along_mm']:.1f} mm of {facts['length_mm']:.1f} mm, " if facts["length_mm"] > 0.05 else ""
        return (
            f"on the {self._path.named(self._path.leg(s))} {facts['pose']} ({way}{facts['percent']:.1f} %), "
            f"{self._frame} at ({x:.3f}, {y:.3f}, {z:.3f}) m"
        )

    def _facts(self, s: float) -> dict[str, Any]:
        k = self._path.leg(s)
        begin, end = self._path.corners[k], self._path.corners[k + 1]
        share = (s - begin) / (end - begin)
        length = self._path.lengths[k] * 1e3
        return {
            "pose": self._numbers[k],
            "along_mm": share * length,
            "length_mm": length,
            "percent": 100.0 * share,
            "position_m": [float(x) for x in self._path.at(s).pose.translation],
        }
