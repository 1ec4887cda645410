"""Execution in a node: the loop of the nets, and the work of the transitions with other tasks and nets."""
