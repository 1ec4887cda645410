"""Commands: ``calibrate_dataset`` and ``next_best_pose``, and how both are told and end."""
