"""QoS profiles, in one place."""

from collections.abc import Sequence

from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSProfile,
    ReliabilityPolicy,
    qos_profile_sensor_data,
)
from rclpy.topic_endpoint_info import TopicEndpointInfo


def _reliable(depth: int, durability: DurabilityPolicy = DurabilityPolicy.VOLATILE) -> QoSProfile:
    """Reliable, with a queue of ``depth`` messages."""
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=durability,
    )


#: The last message of a publisher reaches whoever comes later.
LATCHED = _reliable(1, DurabilityPolicy.TRANSIENT_LOCAL)

#: The same for topics on which several things, or several keys, are latched.
LATCHED_MANY = _reliable(100, DurabilityPolicy.TRANSIENT_LOCAL)

#: How many nets a node can know; each is told of by a publisher of its own.
MOST_NETS = 1000

#: For who listens to what is told of nets: of all of them, also if he comes late.
LATCHED_NETS = _reliable(MOST_NETS, DurabilityPolicy.TRANSIENT_LOCAL)

#: Events that must not be lost.
EVENTS = _reliable(500)

#: Events that also reach who was just being discovered, the newest of them whoever comes later.
LATCHED_EVENTS = _reliable(500, DurabilityPolicy.TRANSIENT_LOCAL)

#: Heartbeats and other state that is repeated.
STATUS = _reliable(50)

#: The clock, a hundred times a second: its nodes want the newest, a recorder that is late all of some seconds.
CLOCK = _reliable(500)

#: Streams of which the newest counts.
SENSOR = qos_profile_sensor_data

#: Commands of which the newest counts, for subscribers of any reliability.
NEWEST = _reliable(1)

#: Images: reliable, so that every subscriber matches, and a short queue, for they are large.
IMAGES = _reliable(5)

#: Services that many clients may call at once, and their clients: the default queue of 10 loses what comes in a burst.
#: Each client is sent the answers to all of them; a loop that is late would find its own pushed out.
SERVICES = _reliable(200)

#: What services and actions tell of what they carry; some of it is large.
SERVICE_EVENTS = _reliable(50)

#: Services that many ask at once: of more requests than the usual 10 that wait, those before are lost without a word.
QUEUED_SERVICE = _reliable(500)


def offered(publishers: Sequence[TopicEndpointInfo], least_depth: int = 1) -> QoSProfile:
    """Return the profile offered by all publishers of a topic: as reliable and as durable as the least.

    Args:
        publishers: The publishers; of none, a reliable and volatile profile.
        least_depth: Least depth of the queue; it is that of the deepest publisher if that is more.
    """
    profiles = [publisher.qos_profile for publisher in publishers]
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in profiles)
    durable = bool(profiles) and all(each.durability == DurabilityPolicy.TRANSIENT_LOCAL for each in profiles)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(least_depth, *(profile.depth for profile in profiles), 1),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if durable else DurabilityPolicy.VOLATILE,
    )
