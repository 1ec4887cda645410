"""How straight the tool goes: 0.4 m at 0.25 m/s, commanded and measured."""

import numpy as np
from numpy.typing import NDArray

from bench.figures import Line
from bench.mcs.rig import Rig, rig
from im_cell.rotations import quaternion_of_matrix
from im_mcs.limits.configuration import McsConfig

_LENGTH_M, _SPEED = 0.4, 0.25
_STARTS = ((0.0, 0.0, 0.0, 0.0, 0.6, 0.0), (0.0, 0.3, -0.4, 0.0, 0.6, 0.0))
"""From home, shape (6,) [rad]."""
_DIRECTIONS = ((0.0, 1.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.48, -0.64), (0.6, -0.48, -0.64))


def lines(config: McsConfig, seed: int) -> list[Line]:
    """Largest distance of the wrist from lines of several places and directions: of setpoints, and of where it was."""
    commanded, measured, speeds = [], [], []
    with rig(config.with_preset("3x6"), seed) as machine:
        machine.to_motion("left")
        home = machine.mcs.groups["left"].planner.setpoint.q
        for start in _STARTS:
            for direction in _DIRECTIONS:
                machine.move("left", home + np.array(start))
                wanted, true, speed = _line(machine, np.array(direction))
                commanded.append(wanted)
                measured.append(true)
                speeds.append(speed)
    return [
        Line(f"{len(speeds)} lines of {_LENGTH_M:g} m: off the line, commanded", 1e3 * max(commanded), "mm", bar=0.05),
        Line("  measured", 1e3 * max(measured), "mm", bar=1.0),
        Line("  commanded, mean of the lines", 1e3 * float(np.mean(commanded)), "mm"),
        Line("  measured, mean of the lines", 1e3 * float(np.mean(measured)), "mm"),
        Line("  largest speed, slowest line", min(speeds), "m/s", _SPEED, "wanted", bar=0.99, at_least=True),
        Line("  largest speed, fastest line", max(speeds), "m/s", _SPEED, "wanted"),
    ]


def _line(machine: Rig, direction: NDArray[np.float64]) -> tuple[float, float, float]:
    """Largest distances of setpoint and truth from the line, the ends included [m], and the largest speed [m/s]."""
    model, mcs = machine.model, machine.mcs
    index, q = mcs.groups["left"].index, machine.setpoint[0].copy()
    start = model.pose(q, "left_wrist")
    ways: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []

    def watch() -> None:
        q[index] = machine.setpoint[0][index]  # the cart is braked: what it reads is noise, not a setpoint
        wanted, true = (model.pose(at, "left_wrist").translation for at in (q, machine.true_q))
        ways.append((wanted - start.translation, true - start.translation))

    pose = [*(start.translation + _LENGTH_M * direction), *quaternion_of_matrix(start.rotation)]
    machine.ask("move", watch, group="left", path={"kind": "line", "poses": [pose], "speed": _SPEED, "blend": 0.0})
    wanted, true = (np.array(way) for way in zip(*ways, strict=True))
    off = [float(np.linalg.norm(way - np.outer(way @ direction, direction), axis=1).max()) for way in (wanted, true)]
    speed = np.abs(np.diff(wanted @ direction)).max() / mcs.config.servo.period_s
    return off[0], off[1], float(speed)
