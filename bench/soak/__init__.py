"""Does anything grow? The same machine for a long time, and what it holds after each command."""
