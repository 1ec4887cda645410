"""The verdict on nets: permission to run, and the firing sequence of a refusal."""
