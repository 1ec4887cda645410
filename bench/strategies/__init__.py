"""Study of learned strategies in a model of a world that changes."""
