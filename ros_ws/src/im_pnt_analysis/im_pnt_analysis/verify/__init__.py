"""The verdict on nets: may they run, and the firing sequence of a refusal."""
