"""Re-timing: a trajectory that asks for more than limits allow, along its own path and as little later as it takes."""

from im_mcs.planning.retiming.retiming import RetimedTrajectory, retime

__all__ = ["RetimedTrajectory", "retime"]
