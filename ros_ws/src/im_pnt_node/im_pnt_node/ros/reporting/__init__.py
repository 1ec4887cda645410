"""What a node tells: firings and markings to topics, clients and the log, and what its nets can be run again from."""
