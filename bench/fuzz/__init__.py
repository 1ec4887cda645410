"""Throws values at every interface of a running machine, found through the graph: ``python -m bench.fuzz --help``."""
