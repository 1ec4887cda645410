"""Points of a joint path in the order of a group."""

from collections.abc import Sequence

from im_core.errors import DataError, NotFoundError


def ordered_points(
    group: str, joints: Sequence[str], given_joints: Sequence[str], points: Sequence[Sequence[float]]
) -> list[list[float]]:
    """Reorder points given for ``given_joints`` to the group's ``joints``.

    Args:
        group: Name of the group, for messages.
        joints: Joints of the group, in order.
        given_joints: Joints the points are given for; empty: those of the group in order.
        points: Positions of each point [rad or m].

    Raises:
        DataError: No points, a joint missing or given twice, or a point of the wrong size.
        NotFoundError: A joint that is not the group's.
    """
    names = list(given_joints) or list(joints)
    for name in names:
        if name not in joints:
            raise NotFoundError(kind=f"joint of group '{group}'", name=name, known=joints)
        if names.count(name) > 1:
            raise DataError(f"joint '{name}' is given {names.count(name)} times", joint=name)
    missing = [name for name in joints if name not in names]
    if missing:
        raise DataError(f"the path of group '{group}' lacks {', '.join(missing)}", missing=missing)
    if not points:
        raise DataError(f"the path of group '{group}' has no points")
    for number, point in enumerate(points, start=1):
        if len(point) != len(names):
            raise DataError(
                f"point {number} of the path has {len(point)} positions, {len(names)} are needed", point=number
            )
    order = [names.index(name) for name in joints]
    return [[float(point[i]) for i in order] for point in points]
