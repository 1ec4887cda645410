"""Kinds of motion, from what is asked for to a trajectory; straight lines are in :mod:`im_mcs.planning.line`."""
