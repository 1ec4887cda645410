"""What is known of a data object."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ObjectRecord:
    """What is known of a data object, without its data.

    Attributes:
        name: Its name.
        version: Counts the puts from 1.
        type: ROS type, e.g. ``geometry_msgs/msg/Pose``.
        hash: Of the definition of that type (REP 2016).
        valid: Whether it may be used.
        place: ``net.place`` that stands for its existence and validity, or empty.
        source: Who changed it last.
        command: The command that it was put for, ``<node>/<life of the node>-<number>``, or empty.
        stamp_ns: Testbed time of the last change [ns].
        size: Of the data [byte].
    """

    name: str
    version: int
    type: str
    hash: str
    valid: bool
    place: str
    source: str
    command: str
    stamp_ns: int
    size: int
