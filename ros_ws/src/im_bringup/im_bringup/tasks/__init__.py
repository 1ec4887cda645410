"""Tasks of a machine: definition, place, agent, and the registry of all tasks."""
