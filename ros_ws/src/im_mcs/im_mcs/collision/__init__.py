"""Collision detector (paper, section 4: integrated "with no modification to the existent MCS core functions")."""

from im_mcs.collision.bodies import Bodies, Closest, Thing
from im_mcs.collision.checker import CollisionChecker
from im_mcs.collision.monitor import CollisionMonitor, Proximity, lever_bounds

__all__ = ["Bodies", "Closest", "CollisionChecker", "CollisionMonitor", "Proximity", "Thing", "lever_bounds"]
