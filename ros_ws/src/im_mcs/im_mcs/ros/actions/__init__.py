"""Actions of groups: the servers, and the motions in the servo behind the goals."""
