"""Re-timing: a trajectory beyond limits, along its own path and as little later as possible."""

from im_mcs.planning.retiming.retiming import RetimedTrajectory, retime

__all__ = ["RetimedTrajectory", "retime"]
