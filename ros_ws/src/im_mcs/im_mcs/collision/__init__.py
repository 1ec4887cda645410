"""Collision detector (paper, section 4: integrated "with no modification to the existent MCS core functions")."""

from im_mcs.collision.bodies import Bodies, Closest
from im_mcs.collision.checker import CollisionChecker
from im_mcs.collision.monitor import CollisionMonitor, Proximity, lever_bounds
from im_mcs.collision.surroundings import NOTHING, AllowedContact, CollisionScene, Thing

__all__ = [
    "NOTHING",
    "AllowedContact",
    "Bodies",
    "Closest",
    "CollisionChecker",
    "CollisionMonitor",
    "CollisionScene",
    "Proximity",
    "Thing",
    "lever_bounds",
]
