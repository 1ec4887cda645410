"""The verdict on nets: may they run, and if not, the firing sequence that shows why."""
