"""What a node executes: the loop of its nets, and what their transitions do with other tasks and other nets."""
