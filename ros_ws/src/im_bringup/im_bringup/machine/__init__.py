"""Machine as a whole: start, phase by phase; record of the running machine; stop; leftovers after a kill."""
