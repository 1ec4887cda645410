"""Re-timing: move a trajectory beyond limits along the same path, with as little delay as possible."""

from im_mcs.planning.retiming.retiming import RetimedTrajectory, retime

__all__ = ["RetimedTrajectory", "retime"]
