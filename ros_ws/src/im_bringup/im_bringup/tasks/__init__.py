"""The tasks of a machine: what they are, where they run, the agent that runs them, the registry of all."""
