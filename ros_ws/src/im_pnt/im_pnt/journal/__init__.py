"""Journal of a process that runs nets: written ahead, checksummed, compacted; brings everything back after a kill."""
