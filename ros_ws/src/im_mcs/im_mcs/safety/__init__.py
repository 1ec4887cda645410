"""Safety supervisor: limits in force at all times, and watches able to stop the machine (not safety-rated)."""

from im_mcs.safety.limiter import SetpointLimiter
from im_mcs.safety.watches import Reaction, SafetyFinding, Situation, Supervisor, Watch

__all__ = ["Reaction", "SafetyFinding", "SetpointLimiter", "Situation", "Supervisor", "Watch"]
