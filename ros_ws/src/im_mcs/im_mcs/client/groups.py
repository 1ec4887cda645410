"""Groups: the present ones, and the measurements of one, from the newest snapshot of the servo."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from im_cell.robot import Group
from im_core.errors import NotFoundError, StateError
from im_mcs.limits.configuration import McsConfig
from im_mcs.model import CellModel


def all_groups(config: McsConfig) -> list[str]:
    """Names of the groups of all presets, in alphabetical order."""
    return sorted({name for groups in config.presets.values() for name in groups})


def group_in_force(config: McsConfig, name: str) -> Group:
    """Return a group of the preset in force.

    Raises:
        StateError: The group is one of another preset; the message says of which.
        NotFoundError: No preset has such a group.
    """
    if name in config.groups:
        return config.groups[name]
    presets = [preset for preset, groups in config.presets.items() if name in groups]
    if not presets:
        raise NotFoundError(kind="group", name=name, known=config.groups)
    raise StateError(
        f"group '{name}' is not in the preset in force, {config.preset} ({', '.join(config.groups)}), but in"
        f" {' and '.join(presets)}; /mcs/set_partition changes it",
        group=name,
        preset=config.preset,
    )


@dataclass(frozen=True)
class GroupState:
    """State of a group, known without motion and without passing time.

    Attributes:
        group: Its name.
        joints: Its joints, in order.
        stamp_ns: Testbed time of ``q`` [ns].
        q: Newest readings, shape (n,) [rad or m].
        v: Estimated velocities, shape (n,) [rad/s or m/s].
        at_rest: Whether a rest measurement holds.
        rest_since_ns: Testbed time at which its window began [ns].
        rest_window: Readings averaged [ticks].
        q_rest: Their mean, shape (n,); empty if not at rest.
        covariance: Of the mean, shape (n, n); empty if not at rest.
        wrist: Pose of the group's wrist in ``world``, if it has one.
        jacobian: Velocity of the wrist's origin, shape (6, n): linear, angular; empty if it has none.
    """

    group: str
    joints: tuple[str, ...]
    stamp_ns: int
    q: NDArray[np.float64]
    v: NDArray[np.float64]
    at_rest: bool
    rest_since_ns: int
    rest_window: int
    q_rest: NDArray[np.float64]
    covariance: NDArray[np.float64]
    wrist: pin.SE3 | None
    jacobian: NDArray[np.float64]


def best_positions(snapshot: NDArray[np.void]) -> NDArray[np.float64]:
    """Positions of all joints, shape (n,): means over rest where there are, else newest readings."""
    return np.where(snapshot["at_rest"], snapshot["q_rest"], snapshot["q"])


def group_state(name: str, group: Group, model: CellModel, snapshot: NDArray[np.void], period_s: float) -> GroupState:
    """Measured state of a group.

    Args:
        name: Name of the group.
        group: Its description.
        model: Kinematics.
        snapshot: Newest state of the servo.
        period_s: Servo period [s].
    """
    index = np.array([model.index(joint) for joint in group.joints], dtype=np.intp)
    at_rest = bool(snapshot["at_rest"][index].all())
    wrist, jacobian = None, np.empty((0, 0))
    if group.wrist is not None:
        q_all = best_positions(snapshot)
        wrist = model.pose(q_all, group.wrist)
        jacobian = model.jacobian(q_all, group.wrist)[:, index]
    return GroupState(
        group=name,
        joints=group.joints,
        stamp_ns=int(snapshot["stamp_ns"]),
        q=snapshot["q"][index],
        v=snapshot["v"][index],
        at_rest=at_rest,
        rest_since_ns=round(int(snapshot["rest_since_tick"][index].max()) * period_s * 1e9) if at_rest else 0,
        rest_window=int(snapshot["rest_window"][index].max()) if at_rest else 0,
        q_rest=snapshot["q_rest"][index] if at_rest else np.empty(0),
        covariance=np.diag(snapshot["q_rest_variance"][index]) if at_rest else np.empty((0, 0)),
        wrist=wrist,
        jacobian=jacobian,
    )
