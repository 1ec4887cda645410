"""Safety supervisor: limits that are always on, and watches that stop the machine (not safety-rated)."""

from im_mcs.safety.limiter import SetpointLimiter
from im_mcs.safety.saturation import KINDS, Saturations
from im_mcs.safety.supervisor import Supervisor
from im_mcs.safety.watch import Finding, Reaction, Situation, Watch

__all__ = ["KINDS", "Finding", "Reaction", "Saturations", "SetpointLimiter", "Situation", "Supervisor", "Watch"]
