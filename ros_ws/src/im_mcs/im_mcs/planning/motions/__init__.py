"""Kinds of motion, from a request to a trajectory; straight lines are in :mod:`im_mcs.planning.line`."""
