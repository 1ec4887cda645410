"""Delivery (QoS) of the messages of a topic, as stored in bags."""

from dataclasses import dataclass
from typing import Any, Self

from rosbags.interfaces import Connection, QosDurability, QosReliability

_FOREVER = {"sec": 9223372036, "nsec": 854775807}


@dataclass(frozen=True)
class Delivery:
    """How the messages of a topic are delivered.

    Attributes:
        reliable: Sent again when lost.
        latched: The last ones reach whoever comes later.
        depth: How many are kept.
    """

    reliable: bool
    latched: bool
    depth: int

    def to_qos(self) -> dict[str, Any]:
        """Return the QoS as written by rosbag2 in a bag of version 9."""
        return {
            "history": "keep_last",
            "depth": self.depth,
            "reliability": "reliable" if self.reliable else "best_effort",
            "durability": "transient_local" if self.latched else "volatile",
            "deadline": dict(_FOREVER),
            "lifespan": dict(_FOREVER),
            "liveliness": "automatic",
            "liveliness_lease_duration": dict(_FOREVER),
            "avoid_ros_namespace_conventions": False,
        }

    @classmethod
    def of(cls, connection: Connection) -> Self:
        """As recorded; reliable and volatile if the bag does not say."""
        profiles = getattr(connection.ext, "offered_qos_profiles", [])
        if not profiles:
            return cls(reliable=True, latched=False, depth=100)
        reliable = all(profile.reliability is not QosReliability.BEST_EFFORT for profile in profiles)
        latched = all(profile.durability is QosDurability.TRANSIENT_LOCAL for profile in profiles)
        return cls(reliable, latched, max(1, *(profile.depth for profile in profiles)))
