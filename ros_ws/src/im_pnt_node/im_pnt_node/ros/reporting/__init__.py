"""Reports of a node: firings and markings to topics, clients and the log, and the events for a re-run."""
