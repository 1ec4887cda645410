"""The Dispatcher (paper, section 6): receives commands, decomposes them by nets, and dispatches their steps."""
