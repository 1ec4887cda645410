"""Parameters of nets from the cell, for ``parameters:`` of a net file."""

import os
from collections.abc import Mapping
from functools import cache

from im_cell.robot import Cell, load_cell
from im_core.names import CELL

TURN = 0.4
"""How far ``demo`` turns the first joint of an arm [rad]."""


def net_parameters() -> Mapping[str, object]:
    """Return the values by name; names of parts are lists, in the order of the cell file.

    Raises:
        ConfigError: The cell is missing or wrong.
    """
    return _of(os.environ.get(CELL))


@cache
def _of(_named: str | None) -> Mapping[str, object]:
    cell = load_cell()
    tips = {group.tip: arm for arm, group in cell.groups.items()}
    riding = {name: tips[camera.parent] for name, camera in cell.cameras.items() if camera.parent in tips}
    checks = [check for name in list(riding)[:1] if (check := cell.cameras[name].check)]
    joints = [len(cell.joints_of(arm)) for arm in cell.groups]
    return {
        **cell.kinds,
        "lit_arms": [arm for arm, group in cell.groups.items() if group.light],
        "gripping_arms": [arm for arm, group in cell.groups.items() if group.gripper],
        "hand_cameras": list(riding),
        "looking_arms": list(riding.values()),
        "checking_arms": [check.arm for check in checks],
        "check_poses": [list(pose) for check in checks for pose in check.shown],
        "check_files": [check.poses for check in checks],
        "printed": [
            *(target.name for target in cell.targets if target.kind == "fiducial" and target.parent == "world"),
            *(body.name for body in cell.objects if body.fiducial is not None),
        ],
        "turned": [_turned(cell, arm) for arm in cell.groups],
        "fewest_joints": min(joints),
        "most_joints": max(joints),
        "stroke": cell.gripper.stroke,
        "force": cell.gripper.force,
        "laser_range": cell.laser.range if cell.laser else 0.0,
    }


def _turned(cell: Cell, arm: str) -> list[float]:
    """Return the home of an arm with the first turning (else sliding) joint moved to the side with room."""
    own = [joint for joint in cell.joints if joint.name in cell.joints_of(arm)]
    carriers = cell.carriers_of(cell.groups[arm].base)
    first = min(own, key=lambda joint: (joint.name in carriers, joint.kind == "prismatic"))
    rank, home = cell.joints_of(arm).index(first.name), list(cell.groups[arm].home)
    above, below = first.limits.upper - home[rank], home[rank] - first.limits.lower
    way = TURN if max(above, below) > TURN else max(above, below) / 2.0
    home[rank] += way if above > way else -way
    return home
