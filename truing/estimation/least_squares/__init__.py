"""Non-linear least squares with damping, for one problem or batches of problems."""
